# SPDX-License-Identifier: GPL-3.0-or-later
"""The program that trains: found, installed, started, followed."""
