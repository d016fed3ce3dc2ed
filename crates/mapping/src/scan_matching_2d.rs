//! stub
use portolan_config::*;
use portolan_geometry::*;
use portolan_matching::Grid2d;
use portolan_sensor::PointCloud;
use crate::submap_2d::Submap2d;
pub struct ScanMatcher2d;
impl ScanMatcher2d {
    pub fn new(_: &TrajectoryBuilder2dOptions) -> Self { Self }
    pub fn match_scan(&self, prediction: Rigid2, _cloud: &PointCloud, _submap: Option<&Submap2d>) -> Rigid2 { prediction }
}
pub struct FastCorrelativeMatcher2d;
pub struct GradientMatcher2d;
pub struct M { pub pose: Rigid2, pub score: f32 }
impl FastCorrelativeMatcher2d {
  pub fn match_local(&self, _: &Rigid2, _: &PointCloud, _: f32) -> Option<M> { None }
  pub fn match_full(&self, _: &PointCloud, _: f32) -> Option<M> { None }
}
impl GradientMatcher2d { pub fn match_scan(&self, _: &Vector2, p: &Rigid2, _: &PointCloud, _: &Grid2d) -> M { M{pose:*p, score:0.} } }
pub fn fast_matcher(_: &Grid2d, _: &FastCorrelativeScanMatcher2dOptions) -> FastCorrelativeMatcher2d { FastCorrelativeMatcher2d }
pub fn gradient_matcher(_: &CeresScanMatcher2dOptions) -> GradientMatcher2d { GradientMatcher2d }
