"""NMES, the Neural Morphogenetic Evolution System."""
