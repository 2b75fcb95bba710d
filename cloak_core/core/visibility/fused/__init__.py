"""Two stages on CUDA as one Triton kernel each; the plain twin of each is in torch/."""
