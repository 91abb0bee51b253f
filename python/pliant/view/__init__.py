"""Browser page to push a simulated arm or control a real one, and to inspect the compliance."""
