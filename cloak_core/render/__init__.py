"""From geometry to images: visibility, shading, cached views, compositing."""
