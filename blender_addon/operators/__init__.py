# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: each checks, calls a plain function of the rooms above, and says what happened."""
