"""The robustness card: one detector under a fixed protocol, as figures (card.json), one page and a leaderboard's line.

`protocol` says what is done, `areas` on which faces; `assessing` does it and fills the card, from `rows`; `pictures`
keeps what was worst; `words`, `figures` and `page` show it, `leaderboard` gathers many.
"""
