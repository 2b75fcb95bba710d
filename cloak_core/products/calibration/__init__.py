"""From a printed and photographed chart to a profile of the printer and the camera."""
