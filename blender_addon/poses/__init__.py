# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 3: the poses to train on, and their export."""
