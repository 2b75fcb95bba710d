"""What leaves the house: reports, prints, carried-over colours, calibrations."""
