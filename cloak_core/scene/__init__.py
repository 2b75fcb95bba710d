"""What is in front of the camera: bodies, logos, cameras, backgrounds."""
