"""Shared ground: configuration, units, errors, records, storage and provenance."""
