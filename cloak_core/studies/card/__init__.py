"""The robustness card: one detector under a fixed protocol, as figures, as a page, and as a leaderboard's line."""
