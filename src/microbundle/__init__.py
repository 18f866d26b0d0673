"""Displacement, strain and beat metrics from movies of cardiac microbundles."""
