"""How a camera turns light into grey values, and how noisy it is: a twin of it for simulation."""
