"""The stages of rendering in torch operations, for any device."""
