"""The content of images as fields that can be averaged, and fields as images again."""
