"""The stages joined: files to exemplars and requests, models to files, recipes done again.

The only room that knows all the others. A run is `inputs` -> `plan` -> `generate`; `resume` and
`replay` start from what a run left.
"""
