"""From views to images and back: dressing for a logo, painting, compositing."""
