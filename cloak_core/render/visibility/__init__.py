"""What is seen: the nearest triangle at samples, or by exact area what is in front of everything else."""
