"""The status page: what an operator looks at, served from the wheel."""
