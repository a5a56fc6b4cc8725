"""What other libraries do on the same sums, each as well as it can: plans kept, buffers reused, all threads."""
