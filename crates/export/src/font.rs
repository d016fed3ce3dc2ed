//! A small stroke font for labels in pictures.
//!
//! Glyphs are polylines on a grid of 4 by 8 units: capitals from y = 0 to the base line at 6, small letters
//! from 2, descenders down to 8. Two digits are a point (x, y), a space lifts the pen, a single point is a
//! dot.

use tiny_skia::{FillRule, LineCap, LineJoin, Paint, PathBuilder, PixmapMut, Stroke, Transform};

/// Height of a capital in units of the grid.
const CAPITAL: f32 = 6.0;
/// Space between two glyphs.
const GAP: f32 = 1.8;
/// Width of the pen.
const PEN: f32 = 0.8;
/// Radius of a dot.
const DOT: f32 = 0.6;

/// Width in units of the grid, and strokes. Characters without a glyph are drawn as an empty box. The
/// function is long because it is a table.
fn glyph(c: char) -> (f32, &'static str) {
    match c {
        ' ' => (1.6, ""),
        '0' | 'O' => (4.0, "103041453616050110"),
        '1' => (3.0, "022026"),
        '2' => (4.0, "01103041420646"),
        '3' => (4.0, "01103041423313 334445361605"),
        '4' => (4.0, "36300444"),
        '5' => (4.0, "400002324345361605"),
        '6' => (4.0, "4130100105163645443303"),
        '7' => (4.0, "004016"),
        '8' => (4.0, "103041423313020110 133344453616050413"),
        '9' => (4.0, "0516364541301001021343"),
        '.' => (0.4, "06"),
        ',' => (0.8, "1607"),
        ':' => (0.4, "02 06"),
        '-' => (3.0, "0333"),
        '+' => (4.0, "0343 2125"),
        '=' => (4.0, "0242 0444"),
        '_' => (4.0, "0747"),
        '/' => (4.0, "0740"),
        '(' => (2.0, "20111526"),
        ')' => (2.0, "00111506"),
        '%' => (4.0, "0640 0010110100 3545463635"),
        '°' => (1.0, "0010110100"),
        'A' => (4.0, "062046 1434"),
        'B' => (4.0, "00063645443303 3342413000"),
        'C' => (4.0, "4130100105163645"),
        'D' => (4.0, "00063645413000"),
        'E' => (4.0, "40000646 0333"),
        'F' => (4.0, "400006 0333"),
        'G' => (4.0, "41301001051636454323"),
        'H' => (4.0, "0006 4046 0343"),
        'I' => (0.4, "0006"),
        'J' => (4.0, "4045361605"),
        'K' => (4.0, "0006 400346"),
        'L' => (4.0, "000646"),
        'M' => (4.0, "0600234046"),
        'N' => (4.0, "06004640"),
        'P' => (4.0, "06003041423303"),
        'Q' => (4.0, "103041453616050110 2446"),
        'R' => (4.0, "06003041423303 2346"),
        'S' => (4.0, "413010010213334445361605"),
        'T' => (4.0, "0040 2026"),
        'U' => (4.0, "000516364540"),
        'V' => (4.0, "002640"),
        'W' => (4.0, "0016233640"),
        'X' => (4.0, "0046 4006"),
        'Y' => (4.0, "002340 2326"),
        'Z' => (4.0, "00400646"),
        'a' => (4.0, "4246 4332120305163645"),
        'b' => (4.0, "0006 0312324345361605"),
        'c' => (4.0, "4332120305163645"),
        'd' => (4.0, "4046 4332120305163645"),
        'e' => (4.0, "04444332120305163645"),
        'f' => (3.0, "30201116 0232"),
        'g' => (4.0, "4247381807 4332120305163645"),
        'h' => (4.0, "0006 0312324346"),
        'i' => (0.4, "0206 00"),
        'j' => (1.0, "121708 10"),
        'k' => (3.0, "0006 320436"),
        'l' => (0.4, "0006"),
        'm' => (4.0, "0206 03122326 23324346"),
        'n' => (4.0, "0206 0312324346"),
        'o' => (4.0, "123243453616050312"),
        'p' => (4.0, "0208 0312324345361605"),
        'q' => (4.0, "4248 4332120305163645"),
        'r' => (3.0, "0206 031232"),
        's' => (4.0, "43321203143445361605"),
        't' => (3.0, "10152636 0232"),
        'u' => (4.0, "0205163645 4246"),
        'v' => (4.0, "022642"),
        'w' => (4.0, "0216243642"),
        'x' => (4.0, "0246 4206"),
        'y' => (4.0, "0226 4218"),
        'z' => (4.0, "02420646"),
        _ => (4.0, "0040460600"),
    }
}

/// Width in pixels of a text whose capitals are `height` pixels high.
pub fn text_width(text: &str, height: f32) -> f32 {
    let units: f32 = text.chars().map(|c| glyph(c).0 + GAP).sum();
    (units - GAP).max(0.0) * height / CAPITAL
}

/// Writes a text with its left end at `x` and its base line at `y`; capitals are `height` pixels high.
pub fn draw_text(pixmap: &mut PixmapMut, text: &str, x: f32, y: f32, height: f32, paint: &Paint) {
    let unit = height / CAPITAL;
    let mut lines = PathBuilder::new();
    let mut dots = PathBuilder::new();
    let mut left = x;
    for c in text.chars() {
        let (width, strokes) = glyph(c);
        for stroke in strokes.split(' ') {
            let points = points(stroke, left, y - height, unit);
            match points[..] {
                [] => {}
                [(x, y)] => dots.push_circle(x, y, DOT * unit),
                [(x, y), ref rest @ ..] => {
                    lines.move_to(x, y);
                    rest.iter().for_each(|(x, y)| lines.line_to(*x, *y));
                }
            }
        }
        left += (width + GAP) * unit;
    }
    let pen = Stroke {
        width: PEN * unit,
        line_cap: LineCap::Round,
        line_join: LineJoin::Round,
        ..Stroke::default()
    };
    if let Some(path) = lines.finish() {
        pixmap.stroke_path(&path, paint, &pen, Transform::identity(), None);
    }
    if let Some(path) = dots.finish() {
        pixmap.fill_path(&path, paint, FillRule::Winding, Transform::identity(), None);
    }
}

fn points(stroke: &str, left: f32, top: f32, unit: f32) -> Vec<(f32, f32)> {
    let digit = |b: &u8| f32::from(b.saturating_sub(b'0'));
    let pairs = stroke.as_bytes().chunks_exact(2);
    pairs
        .filter_map(|pair| match pair {
            [x, y] => Some((left + digit(x) * unit, top + digit(y) * unit)),
            _ => None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stroke_is_on_the_grid() {
        for c in (' '..='~').chain(['°']) {
            let (width, strokes) = glyph(c);
            for stroke in strokes.split(' ') {
                assert_eq!(stroke.len() % 2, 0, "{c}");
                for (x, y) in points(stroke, 0.0, 0.0, 1.0) {
                    assert!(x <= width.ceil() && y <= 8.0, "{c}");
                }
            }
        }
    }

    #[test]
    fn width_is_that_of_the_ink() {
        let mut pixmap = tiny_skia::Pixmap::new(200, 40).unwrap();
        draw_text(&mut pixmap.as_mut(), "20 m", 10.0, 30.0, 18.0, &Paint::default());
        let inked = |x: u32| (0..40).any(|y| pixmap.pixel(x, y).unwrap().alpha() > 0);
        let last = (0..200).rev().find(|x| inked(*x)).unwrap() as f32;
        assert!((last - 10.0 - text_width("20 m", 18.0)).abs() < 3.0, "{last}");
        assert!(inked(10) && !inked(5));
    }
}
