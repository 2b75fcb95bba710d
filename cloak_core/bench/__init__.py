"""Speed against error, stability, growth, and peers."""
