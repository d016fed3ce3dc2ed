//! Colours of pictures.

/// Red, green, blue from 0 to 1.
pub type Rgb = [f32; 3];

/// A colour from its usual notation `0xrrggbb`.
pub const fn rgb(code: u32) -> Rgb {
    [(code >> 16 & 255) as f32 / 255.0, (code >> 8 & 255) as f32 / 255.0, (code & 255) as f32 / 255.0]
}

/// The colour of trajectory number `index`: hues at multiples of the golden angle, so that neighbours differ
/// (`formats.md §6.4`).
pub fn palette(index: usize) -> Rgb {
    const GOLDEN_RATIO_CONJUGATE: f64 = 0.6180339887498949;
    let hue = (0.69 + GOLDEN_RATIO_CONJUGATE * index as f64).fract() as f32;
    hsv(hue, 0.85, 0.77)
}

/// Hue, saturation and value, each from 0 to 1.
pub fn hsv(hue: f32, saturation: f32, value: f32) -> Rgb {
    let sixth = hue.rem_euclid(1.0) * 6.0;
    let chroma = value * saturation;
    let x = chroma * (1.0 - (sixth % 2.0 - 1.0).abs());
    let [r, g, b] = match sixth as u32 {
        0 => [chroma, x, 0.0],
        1 => [x, chroma, 0.0],
        2 => [0.0, chroma, x],
        3 => [0.0, x, chroma],
        4 => [x, 0.0, chroma],
        _ => [chroma, 0.0, x],
    };
    [r, g, b].map(|v| v + value - chroma)
}

/// Interpolates from `a` (at 0) to `b` (at 1).
pub fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// Eight bits per channel.
pub fn to_bytes(colour: Rgb) -> [u8; 3] {
    colour.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primary_hues() {
        let primaries =
            [0.0, 1.0 / 6.0, 1.0 / 3.0, 0.5, 2.0 / 3.0, 5.0 / 6.0].map(|h| to_bytes(hsv(h, 1.0, 1.0)));
        assert_eq!(
            primaries,
            [[255, 0, 0], [255, 255, 0], [0, 255, 0], [0, 255, 255], [0, 0, 255], [255, 0, 255]]
        );
        assert_eq!(to_bytes(hsv(0.3, 0.0, 0.5)), [128; 3]);
        assert_eq!(to_bytes(rgb(0x12fe80)), [0x12, 0xfe, 0x80]);
    }
}
