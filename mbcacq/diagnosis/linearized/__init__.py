"""The recording linearised at its geometric fit: whitening, variance components, geometry."""
