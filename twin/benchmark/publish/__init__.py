"""What makes results fit for print: what they depend on, tables, and the check of a submission.

May be imported by twin.benchmark and above; ``sources`` imports nothing of twin.benchmark.
"""
