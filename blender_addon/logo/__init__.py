# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 2: the faces that get trained colours."""
