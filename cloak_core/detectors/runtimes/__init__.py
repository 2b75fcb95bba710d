"""Files that other runtimes run, as black boxes: `openvino:FILE.xml` and `tflite:FILE.tflite`."""
