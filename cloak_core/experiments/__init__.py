"""The paper's tables and figures, and experiments of our own, as declarations over `studies`.

Each of `declared` says what is trained, what judges, what is plotted, what the paper has; `options.EXPERIMENTS` lists
them. `runner` measures and draws, `publish` makes the page and the records; nothing but commands imports this room.
"""
