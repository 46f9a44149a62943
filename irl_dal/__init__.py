"""IRL-DAL: imitation, reinforcement and guided diffusion planning under a safety shield."""
