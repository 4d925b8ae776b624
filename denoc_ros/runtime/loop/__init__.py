"""The real-time loop: clocks, deadlines, status, end."""
