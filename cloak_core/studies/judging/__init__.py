"""Judge photographs of real prints."""
