//! Wavefront OBJ: `v x y z`, and `f a b c …` with numbers counted from one, or backwards from −1.

use super::Mesh;

pub(super) fn is_obj(bytes: &[u8]) -> bool {
    lines(bytes).take(1000).any(|line| line.starts_with("v "))
}

fn lines(bytes: &[u8]) -> impl Iterator<Item = &str> {
    bytes.split(|byte| *byte == b'\n').filter_map(|line| Some(std::str::from_utf8(line).ok()?.trim()))
}

pub(super) fn read(bytes: &[u8]) -> Mesh {
    let (mut mesh, mut vertices) = (Mesh::default(), Vec::new());
    let mut corners = Vec::new();
    for line in lines(bytes) {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut next = || words.next().and_then(|w| w.parse().ok()).unwrap_or(f64::NAN);
                vertices.push([next(), next(), next()]);
            }
            Some("f") => {
                corners.clear();
                // `corner/texture/normal`: only the first number is used; a word that is not a number is an
                // invalid corner.
                corners.extend(words.map(|word| {
                    let number = word.split('/').next().and_then(|n| n.parse::<i64>().ok());
                    match number {
                        Some(n) if n > 0 => (n - 1) as usize,
                        Some(n) if n < 0 => (vertices.len() as i64 + n) as usize,
                        _ => usize::MAX,
                    }
                }));
                mesh.add(&vertices, &corners);
            }
            _ => {}
        }
    }
    mesh
}
