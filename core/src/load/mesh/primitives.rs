//! Mitsuba's rectangle and cube as meshes, with its vertices, normals and texture coordinates.

use super::FileMesh;
use glam::{DVec3, Vec2, Vec3};

/// The square from (−1, −1, 0) to (1, 1, 0), normal +z; u along x, v along y.
pub(crate) fn rectangle() -> FileMesh {
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    FileMesh {
        positions: corners.iter().map(|(u, v)| DVec3::new(2.0 * u - 1.0, 2.0 * v - 1.0, 0.0)).collect(),
        normals: vec![Vec3::Z; 4],
        uvs: corners.iter().map(|(u, v)| Vec2::new(*u as f32, *v as f32)).collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..FileMesh::default()
    }
}

/// The cube from (−1, −1, −1) to (1, 1, 1), normals outwards, the unit square on each face.
pub(crate) fn cube() -> FileMesh {
    // The corners of each face in Mitsuba's order: their texture coordinates are the same on all.
    let faces: [(Vec3, [[i8; 3]; 4]); 6] = [
        (Vec3::NEG_Y, [[1, -1, -1], [1, -1, 1], [-1, -1, 1], [-1, -1, -1]]),
        (Vec3::Y, [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]]),
        (Vec3::X, [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]]),
        (Vec3::Z, [[1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1]]),
        (Vec3::NEG_X, [[-1, -1, 1], [-1, 1, 1], [-1, 1, -1], [-1, -1, -1]]),
        (Vec3::NEG_Z, [[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]]),
    ];
    let mut mesh = FileMesh::default();
    for (face, (normal, corners)) in (0u32..).zip(faces) {
        mesh.positions.extend(corners.map(|[x, y, z]| DVec3::new(x.into(), y.into(), z.into())));
        mesh.normals.extend([normal; 4]);
        mesh.uvs.extend([Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0), Vec2::new(0.0, 0.0)]);
        let first = 4 * face;
        mesh.triangles.extend([[first, first + 1, first + 2], [first + 3, first, first + 2]]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The texture coordinate and the two tangents at a point of a face.
    fn surface_at(mesh: &FileMesh, point: DVec3) -> (Vec2, DVec3, DVec3) {
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
            let [ta, tb, tc] = triangle.map(|i| mesh.uvs[i as usize].as_dvec2());
            let (e1, e2, n) = (b - a, c - a, (b - a).cross(c - a));
            let (s, t) = ((point - a).cross(e2).dot(n) / n.dot(n), e1.cross(point - a).dot(n) / n.dot(n));
            if (point - a).dot(n).abs() < 1e-9 && s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
                let (d1, d2) = (tb - ta, tc - ta);
                let det = d1.perp_dot(d2);
                let uv = ta + d1 * s + d2 * t;
                return (uv.as_vec2(), (e1 * d2.y - e2 * d1.y) / det, (e2 * d1.x - e1 * d2.x) / det);
            }
        }
        panic!("no triangle at {point}");
    }

    /// Numbers from Mitsuba 3.9.1: a ray onto (0.2, 0.3, ·) from above.
    #[test]
    fn texture_coordinates_and_tangents_are_mitsubas() {
        let (uv, du, dv) = surface_at(&rectangle(), DVec3::new(0.2, 0.3, 0.0));
        assert!((uv - Vec2::new(0.6, 0.65)).length() < 1e-6, "{uv}");
        assert!((du - 2.0 * DVec3::X).length() < 1e-9 && (dv - 2.0 * DVec3::Y).length() < 1e-9);
        let (uv, du, dv) = surface_at(&cube(), DVec3::new(0.2, 0.3, 1.0));
        assert!((uv - Vec2::new(0.65, 0.6)).length() < 1e-6, "{uv}");
        assert!((du - 2.0 * DVec3::Y).length() < 1e-9 && (dv - 2.0 * DVec3::X).length() < 1e-9);
    }

    #[test]
    fn face_normals_agree_with_vertex_normals() {
        for mesh in [rectangle(), cube()] {
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
                let face = (b - a).cross(c - a).normalize();
                assert!(triangle.iter().all(|&i| mesh.normals[i as usize].as_dvec3() == face));
            }
        }
    }
}
