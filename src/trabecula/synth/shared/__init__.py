"""What methods share: fields of labels, pyramids, neighbourhoods, histogram matching. Knows no
method.
"""
