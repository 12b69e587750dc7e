"""Files to Images and back: one file per format, one table of suffixes (`formats`)."""
