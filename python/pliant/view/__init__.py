"""A page in the browser: push a simulated arm, or watch a real one, and see why it is soft."""
