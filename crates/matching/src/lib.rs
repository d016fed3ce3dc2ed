//! Grids and scan matching: probability grids, TSDF, correlative and gradient matchers
