# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: each checks, calls a plain function of the rooms above, and says what happened."""

from . import body, logo, result, train

CLASSES = (*body.CLASSES, *logo.CLASSES, *train.CLASSES, *result.CLASSES)
