"""What is behind the bodies: photographs and procedural scenes."""
