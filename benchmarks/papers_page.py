"""Page."""


def page() -> str:
    return ""
