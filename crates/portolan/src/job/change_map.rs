//! Writes contradictions between a recording and the map it was localised in: GeoJSON and lines of pictures.

use portolan_export::{ColouredLine, rgb};
use portolan_geometry::Time;
use portolan_localization::{Change, ChangeKind};
use serde_json::{Value, json};

/// All changes in the frame of the map, metres; times are seconds since 1970.
pub(super) fn geojson(changes: &[Change], recorded: impl Fn(Time) -> Time) -> Value {
    let closed = |ring: &Vec<[f64; 2]>| -> Vec<[f64; 2]> {
        let millimetres = |p: &[f64; 2]| p.map(|v| (1e3 * v).round() / 1e3);
        ring.iter().chain(ring.first()).map(millimetres).collect()
    };
    let feature = |change: &Change| {
        let rings: Vec<_> = change.rings.iter().map(closed).collect();
        let mut properties = json!({
            "kind": change.kind.name(),
            "area_m2": (1e4 * change.area).round() / 1e4,
            "first_seen": recorded(change.seen.0).unix_seconds(),
            "last_seen": recorded(change.seen.1).unix_seconds(),
            "scans": change.scans,
        });
        if let (Some([from, to]), Some(properties)) = (change.heights, properties.as_object_mut()) {
            let millimetres = |height: f64| json!((1e3 * height).round() / 1e3);
            properties.insert("from_z".to_owned(), millimetres(from));
            properties.insert("to_z".to_owned(), millimetres(to));
        }
        let geometry = json!({ "type": "Polygon", "coordinates": rings });
        json!({ "type": "Feature", "geometry": geometry, "properties": properties })
    };
    let features: Vec<Value> = changes.iter().map(feature).collect();
    json!({ "type": "FeatureCollection", "frame": "map, metres", "features": features })
}

/// Outlines: magenta for appeared surfaces, blue for those that are gone.
pub(super) fn outlines(changes: &[Change]) -> Vec<ColouredLine> {
    let outline = |change: &Change| {
        let colour = match change.kind {
            ChangeKind::Appeared => rgb(0xd01c8b),
            ChangeKind::Gone => rgb(0x1f78b4),
        };
        let line = move |ring: &Vec<[f64; 2]>| ColouredLine {
            colour,
            points: ring.iter().chain(ring.first()).copied().collect(),
        };
        change.rings.iter().map(line).collect::<Vec<_>>()
    };
    changes.iter().flat_map(outline).collect()
}
