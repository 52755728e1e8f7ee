"""HTTP in a process of its own: whatever is asked, and by however many, the filters keep the interpreter."""
