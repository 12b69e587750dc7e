"""A plugin of napari (extra `napari`): reader, writer, samples, and panels to inspect a scan,
generate material and certify it. `napari.yaml` declares it; nothing here is imported elsewhere.
"""
