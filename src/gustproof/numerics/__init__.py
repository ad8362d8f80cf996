"""Linear systems, their norms, margins and Riccati equations."""
