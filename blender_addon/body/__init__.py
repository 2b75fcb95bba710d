# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 1: the body and what it wears."""
