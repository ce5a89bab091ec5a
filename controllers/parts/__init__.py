"""The parts of composed laws, which `composition.compose` puts around a law."""
