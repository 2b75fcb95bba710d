"""People in photographs: read, fitted, and dressed; a source of views."""
