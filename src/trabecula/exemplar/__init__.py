"""Image -> Image to learn from: segment, crop, and the samples that the package makes itself."""
