"""Software renderer: triangles to a depth buffer, then light, texture and shadow per pixel."""
