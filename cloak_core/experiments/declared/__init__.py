"""Declarations of experiments; `options.EXPERIMENTS` says which they are."""
