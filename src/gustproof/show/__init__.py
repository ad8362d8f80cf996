"""Show results: pages, charts, the live page, the paper's tables."""
