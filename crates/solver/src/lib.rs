//! Least squares: small dense problems and block-sparse pose problems, with robust losses
