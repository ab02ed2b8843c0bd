"""The pictures of a benchmark.

Nothing here computes a result. matplotlib is imported when the first picture is drawn, and never
through pyplot: neither an import nor a picture changes anything for the caller.
"""
