"""ONNX files: converted to torch and checked against onnxruntime, or run by it as a black box.

Read in this order: `model_file` (what a file says of itself), `decoders` (from outputs to boxes), `layouts` (the table
of these, and which a file has), `networks` (conversion, and is it right), `detector`.
"""
