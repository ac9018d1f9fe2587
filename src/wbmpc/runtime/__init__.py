"""The real-time runner: clocks, shared memory, the solver's process, safety."""
