"""Files that other runtimes run, as black boxes: `openvino:FILE.xml` and `tflite:FILE.tflite`.

Read in this order: `model` (what a file says of itself and how it is run), `openvino_file`, `tflite_file`, `layouts`
(outputs that only these have), `loading`.
"""
