#![doc = include_str!("../README.md")]

mod colour;
mod font;
mod histogram;
mod html;
mod map_lines;
mod overlay;
mod path;
mod picture;
mod plot;
mod png_file;
mod point_picture;
pub mod points;
mod raster;
mod tum;
mod xray;

pub use colour::{Rgb, hsv, mix, palette, rgb, to_bytes};
pub use font::{draw_text, text_width};
pub use histogram::{HistogramPanel, draw_histograms};
pub use html::{HtmlPage, Mark, escape, marked_picture, scale_mark};
pub use map_lines::{constraint_lines, trajectory_lines};
pub use overlay::{ConstraintLine, TrajectoryLine};
pub use path::{ColouredLine, draw_path};
pub use picture::{MAX_EDGE, MapContent, Picture, PictureError, PictureOptions, draw_map, extent};
pub use plot::{PlotBars, PlotLabels, PlotLine, bar_plot, line_plot};
pub use png_file::{write_grey_map, write_picture};
pub use point_picture::{PointImage, PointView, encode_grey};
pub use raster::{Frame, MapColours};
pub use tum::{tum_line, write_tum};
pub use xray::{CloudSample, Extent, XrayPicture, XrayView, colour_of_share};
