# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 4: trainings and the folders they leave."""
