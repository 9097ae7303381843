"""The default solver: inertia by harmonics, massless contact at every time sample."""
