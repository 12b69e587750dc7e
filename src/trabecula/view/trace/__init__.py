"""Path-traced stills: smooth surfaces from labels, materials that vary in space, light that
scatters inside them, a camera with a lens and a film.
"""
