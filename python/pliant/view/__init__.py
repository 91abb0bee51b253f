"""Browser page to push a simulated arm or watch a real one, and to inspect its compliance."""
