"""The paper's tables and figures, and experiments of our own, as declarations over `studies`.

A module of `declared` is one experiment: what is trained, what judges, what is plotted, what the paper has. Its being
there registers it. `runner` measures, draws and publishes; nothing but commands imports this room.
"""
