"""Other renderers, each behind one protocol, for `cloak bench accuracy`; the extra `peers` installs them."""
