"""ONNX files: converted to torch and checked against onnxruntime, or run by it as a black box.

Read in this order: `model_file` (what a file says of itself), `layouts` (from outputs to boxes), `networks`
(conversion), `parity` (is the conversion right), `detector`.
"""
