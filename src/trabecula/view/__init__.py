"""Image -> picture: stills of volumes, sheets of slices. One table of looks for both."""
