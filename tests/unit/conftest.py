from pathlib import Path

UNITS = Path(__file__).parent
WITHOUT_KERNELS = {
    "campaign",
    "certify",
    "cli",
    "exchange",
    "model",
    "numerics",
    "recording",
    "report",
    "synthesis",
    "view",
}


def pytest_collection_modifyitems(items):
    """Mark what runs alike with kernels compiled and as plain Python: to run it once is enough."""
    for item in items:
        if not item.path.is_relative_to(UNITS) or item.get_closest_marker("compiled"):
            continue
        if item.path.relative_to(UNITS).parts[0] in WITHOUT_KERNELS:
            item.add_marker("plain")
