use super::*;

const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]];

fn expected() -> Vec<Triangle> {
    vec![Triangle([SQUARE[0], SQUARE[1], SQUARE[2]]), Triangle([SQUARE[0], SQUARE[2], SQUARE[3]])]
}

fn ply(format: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty double y\n\
         property float z\nproperty uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    for [x, y, z] in SQUARE {
        match format {
            "ascii" => bytes.extend(format!("{x} {y} {z} 7\n").bytes()),
            "binary_little_endian" => {
                bytes.extend((x as f32).to_le_bytes());
                bytes.extend(y.to_le_bytes());
                bytes.extend((z as f32).to_le_bytes());
                bytes.push(7);
            }
            _ => {
                bytes.extend((x as f32).to_be_bytes());
                bytes.extend(y.to_be_bytes());
                bytes.extend((z as f32).to_be_bytes());
                bytes.push(7);
            }
        }
    }
    if format == "ascii" {
        bytes.extend(b"4 0 1 2 3\n");
    } else {
        bytes.push(4);
        for i in 0..4_i32 {
            bytes.extend(if format.contains("little") { i.to_le_bytes() } else { i.to_be_bytes() });
        }
    }
    bytes
}

fn stl_binary() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(2_u32.to_le_bytes());
    for Triangle(corners) in expected() {
        bytes.extend([0; 12]);
        bytes.extend(corners.iter().flatten().flat_map(|v| (*v as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn stl_text() -> Vec<u8> {
    let mut text = "solid square\n".to_owned();
    for Triangle(corners) in expected() {
        text += "facet normal 0 0 1\n outer loop\n";
        for [x, y, z] in corners {
            text += &format!("  vertex {x} {y} {z}\n");
        }
        text += " endloop\nendfacet\n";
    }
    text.into_bytes()
}

fn all_formats() -> Vec<Vec<u8>> {
    let obj =
        b"# a square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nvn 0 0 1\nf 1//1 2//1 3//1 -1//1\n".to_vec();
    vec![ply("ascii"), ply("binary_little_endian"), ply("binary_big_endian"), stl_binary(), stl_text(), obj]
}

#[test]
fn every_format_gives_the_same_triangles() {
    for (number, bytes) in all_formats().iter().enumerate() {
        assert!(is_mesh(bytes), "{number}");
        let mesh = read_mesh(bytes).unwrap();
        assert_eq!((mesh.triangles, mesh.left_out), (expected(), 0), "{number}");
    }
}

#[test]
fn damaged_files_are_errors_or_lose_counted_faces() {
    for bytes in all_formats() {
        for cut in (0..bytes.len()).step_by(3) {
            // Any result is allowed; it must not panic.
            let _ = read_mesh(&bytes[..cut]);
            let mut changed = bytes.clone();
            changed[cut] ^= 0x55;
            let _ = read_mesh(&changed);
        }
    }
    assert!(read_mesh(b"").is_err() && read_mesh(b"0,0,0,1,1,1\n").is_err());
    assert!(read_mesh(b"ply\nformat ascii 1.0\nelement face 99999999999\nend_header\n").is_err());
    let mesh = read_mesh(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n").unwrap();
    assert_eq!((mesh.triangles.len(), mesh.left_out), (1, 1));
}
