"""What each `cloak` command takes and prints; the work itself is done in the other rooms."""
