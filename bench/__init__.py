"""Where OpenCL stands against the best that other libraries do on the same sums; run as `python -m bench`."""
