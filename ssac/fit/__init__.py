"""A problem of least squares in, its robust solution and an honest covariance out."""
