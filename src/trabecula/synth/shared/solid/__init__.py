"""Solid texture from pictures: search and vote on the planes of up to three views."""
