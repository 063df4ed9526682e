//! Writes a PLY file of about a million triangles, a sheet in waves with normals and texture coordinates, and a scene around
//! it: what docs/performance.md measures loading with.
//!
//! `cargo run --release -p tilecast-bench --bin sheet -- FOLDER [SIDE]`: SIDE vertices a side, 2 (SIDE − 1)² triangles.

use std::fmt::Write as _;
use std::path::Path;

/// 999,698 triangles.
const SIDE: u32 = 708;

const SCENE: &str = r#"<scene version="3.0.0">
    <integrator type="path"/>
    <shape type="ply">
        <string name="filename" value="sheet.ply"/>
    </shape>
    <emitter type="constant"/>
</scene>
"#;

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (folder, side) = (arguments.next(), arguments.next().map_or(Ok(SIDE), |side| side.parse()));
    let (Some(folder), Ok(side @ 2..=20_000)) = (folder, side) else {
        eprintln!("usage: sheet FOLDER [SIDE], with a side of 2 to 20000 vertices");
        std::process::exit(2);
    };
    let folder = Path::new(&folder);
    std::fs::write(folder.join("sheet.ply"), sheet(side))?;
    std::fs::write(folder.join("sheet.xml"), SCENE)?;
    println!("wrote {} with {} triangles", folder.join("sheet.ply").display(), 2 * (side - 1) * (side - 1));
    Ok(())
}

/// The file's bytes: little endian, 32 bytes a vertex, 13 a triangle.
fn sheet(side: u32) -> Vec<u8> {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
    let _ = writeln!(header, "element vertex {}", side * side);
    ["x", "y", "z", "nx", "ny", "nz", "u", "v"]
        .iter()
        .for_each(|name| header.push_str(&format!("property float {name}\n")));
    let _ = writeln!(header, "element face {}", 2 * (side - 1) * (side - 1));
    header.push_str("property list uchar int vertex_indices\nend_header\n");
    let mut bytes = header.into_bytes();
    for (row, column) in (0..side).flat_map(|row| (0..side).map(move |column| (row, column))) {
        let [u, v] = [column, row].map(|i| i as f32 / (side - 1) as f32);
        let (x, y) = ((31.0 * u).sin_cos(), (29.0 * v).sin_cos());
        let slopes = [0.05 * 15.5 * x.1 * y.0, 0.05 * 14.5 * x.0 * y.1];
        let length = (slopes[0] * slopes[0] + slopes[1] * slopes[1] + 1.0).sqrt();
        let position = [2.0 * u - 1.0, 2.0 * v - 1.0, 0.05 * x.0 * y.0];
        let normal = [-slopes[0] / length, -slopes[1] / length, 1.0 / length];
        position.iter().chain(&normal).chain(&[u, v]).for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    for (row, column) in (0..side - 1).flat_map(|row| (0..side - 1).map(move |column| (row, column))) {
        let a = row * side + column;
        for corners in [[a, a + 1, a + side + 1], [a, a + side + 1, a + side]] {
            bytes.push(3);
            corners.iter().for_each(|corner| bytes.extend(corner.to_le_bytes()));
        }
    }
    bytes
}
