"""A software renderer: triangles to a depth buffer, then light, texture and shadow for each pixel."""
