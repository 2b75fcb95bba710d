"""People in photographs as views: faces laid onto their clothes."""
