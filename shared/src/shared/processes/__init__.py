"""Processes: workers that may die, interrupts, the machine; and how what a program takes is declared and told."""
