"""Pure against projected diffusion: one checkpoint, the same seeds, the same noise, one switch."""
