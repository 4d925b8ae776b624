"""Servos of position-controlled joints."""
