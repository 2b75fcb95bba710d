# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 5: colours on the model, and what they are worth."""
