//! Triangle meshes on their way from files to the scene: f64 in object space, then f32 in scene coordinates.
//!
//! Knows nothing of materials or scenes; the readers of the formats stand beside it.

pub(crate) mod obj;
pub(crate) mod ply;
pub(crate) mod primitives;
pub(crate) mod serialized;

use crate::scene::{Attribute, AttributeValues, Mesh};
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};

/// A mesh as a file has it. `normals` and `uvs` have one entry a position, or none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FileMesh {
    pub positions: Vec<DVec3>,
    /// Of any length; zero where a vertex has none.
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    pub triangles: Vec<[u32; 3]>,
    /// Faces of fewer than three corners, left out.
    pub incomplete_faces: usize,
    /// Those of its attributes that were asked for.
    pub attributes: Vec<Attribute>,
    /// The names of all attributes that the file has.
    pub attribute_names: Vec<String>,
}

/// How a mesh stands in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    pub to_world: DAffine3,
    /// Shade with the faces' own normals, whatever the file has.
    pub face_normals: bool,
    /// Turn all normals to the other side.
    pub flip_normals: bool,
    /// v becomes 1 − v.
    pub flip_v: bool,
}

impl Placement {
    pub const IDENTITY: Self =
        Self { to_world: DAffine3::IDENTITY, face_normals: false, flip_normals: false, flip_v: false };
}

/// The smallest box around all positions, in world space.
pub(crate) fn bounds(mesh: &FileMesh, to_world: &DAffine3) -> Option<(DVec3, DVec3)> {
    let mut corners = mesh.positions.iter().map(|p| to_world.transform_point3(*p));
    let first = corners.next()?;
    Some(corners.fold((first, first), |(min, max), p| (min.min(p), max.max(p))))
}

/// A mesh in scene coordinates (world space less `origin`), and how many degenerate triangles were left out.
///
/// Like Mitsuba: vertex normals go by the inverse transpose; a mesh without any gets smooth ones (unless `face_normals`);
/// a mirroring transformation leaves the order of vertices, so that it turns the faces' own normals.
///
/// # Errors
/// A position beyond f32.
pub(crate) fn to_scene(mesh: &FileMesh, placement: &Placement, origin: DVec3) -> Result<(Mesh, usize), String> {
    let world: Vec<DVec3> = mesh.positions.iter().map(|p| placement.to_world.transform_point3(*p) - origin).collect();
    let positions: Vec<Vec3> = world.iter().map(|p| p.as_vec3()).collect();
    if positions.iter().any(|p| !p.is_finite()) {
        return Err("a vertex lies farther out than 32-bit numbers reach (3e38)".into());
    }
    let mut triangles: Vec<[u32; 3]> = mesh.triangles.iter().copied().filter(|t| has_area(&positions, *t)).collect();
    let degenerate = mesh.triangles.len() - triangles.len();
    let attributes =
        mesh.attributes.iter().map(|attribute| of_triangles_with_area(attribute, mesh, &positions)).collect();
    let mut normals = match placement.face_normals {
        true => Vec::new(),
        false => vertex_normals(mesh, &world, &triangles, placement.to_world.matrix3),
    };
    let mut uvs = mesh.uvs.clone();
    if placement.flip_normals {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
        normals.iter_mut().for_each(|n| *n = -*n);
    }
    if placement.flip_v {
        uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
    }
    Ok((Mesh { positions, normals, uvs, triangles, attributes }, degenerate))
}

/// An attribute without the values of degenerate triangles, if it lies on triangles.
fn of_triangles_with_area(attribute: &Attribute, mesh: &FileMesh, positions: &[Vec3]) -> Attribute {
    fn kept<T: Copy>(values: &[T], mesh: &FileMesh, positions: &[Vec3]) -> Vec<T> {
        let pairs = mesh.triangles.iter().zip(values);
        pairs.filter(|(triangle, _)| has_area(positions, **triangle)).map(|(_, value)| *value).collect()
    }
    let values = match &attribute.values {
        _ if !attribute.is_on_faces() => attribute.values.clone(),
        AttributeValues::Scalars(values) => AttributeValues::Scalars(kept(values, mesh, positions)),
        AttributeValues::Colours(values) => AttributeValues::Colours(kept(values, mesh, positions)),
    };
    Attribute { name: attribute.name.clone(), values }
}

/// Whether a triangle's corners span an area, in the coordinates that will be traced.
fn has_area(positions: &[Vec3], triangle: [u32; 3]) -> bool {
    let [a, b, c] = triangle.map(|i| positions[i as usize].as_dvec3());
    (b - a).cross(c - a) != DVec3::ZERO
}

/// Unit normals by the inverse transpose of `linear`; smooth ones where the file has none.
fn vertex_normals(mesh: &FileMesh, world: &[DVec3], triangles: &[[u32; 3]], linear: DMat3) -> Vec<Vec3> {
    // The matrix of cofactors: the inverse transpose times the determinant, whose sign is put right.
    let cofactors = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    ) * linear.determinant().signum();
    let given: Vec<Vec3> =
        mesh.normals.iter().map(|n| (cofactors * n.as_dvec3()).normalize_or_zero().as_vec3()).collect();
    if !given.is_empty() && !given.contains(&Vec3::ZERO) {
        return given;
    }
    let smooth = smooth_normals(world, triangles);
    let pick = |i: usize, smooth: Vec3| given.get(i).copied().filter(|n| *n != Vec3::ZERO).unwrap_or(smooth);
    smooth.into_iter().enumerate().map(|(i, smooth)| pick(i, smooth)).collect()
}

/// At each vertex the sum of its faces' unit normals, each weighted by the face's angle there (Thürmer & Wüthrich 1998),
/// made a unit vector. +x where that is zero or no face is, as in Mitsuba.
fn smooth_normals(world: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; world.len()];
    for triangle in triangles {
        let corners = triangle.map(|i| world[i as usize]);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        for k in 0..3 {
            let to_next = corners[(k + 1) % 3] - corners[k];
            let to_last = corners[(k + 2) % 3] - corners[k];
            sums[triangle[k] as usize] += (normal * angle_between(to_next, to_last)).as_vec3();
        }
    }
    sums.into_iter().map(|sum| sum.as_dvec3().try_normalize().unwrap_or(DVec3::X).as_vec3()).collect()
}

/// In radians; exact also for tiny and nearly straight angles (Kahan 2006, "How Futile are Mindless Assessments…", §12).
fn angle_between(a: DVec3, b: DVec3) -> f64 {
    let (a, b) = (a.normalize_or_zero(), b.normalize_or_zero());
    2.0 * libm::atan2((a - b).length(), (a + b).length())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> FileMesh {
        FileMesh {
            positions: vec![DVec3::ZERO, DVec3::Y, DVec3::X, DVec3::Z],
            triangles: vec![[0, 1, 2], [0, 2, 3], [2, 1, 3], [0, 3, 1]],
            ..FileMesh::default()
        }
    }

    /// Numbers from Mitsuba 3.9.1 for the same tetrahedron.
    #[test]
    fn missing_normals_are_smooth_ones() {
        let (mesh, degenerate) = to_scene(&tetrahedron(), &Placement::IDENTITY, DVec3::ZERO).unwrap();
        assert_eq!(degenerate, 0);
        let expected = [[-0.5773503; 3], [-0.2754214, 0.92102444, -0.27542138], [0.92102444, -0.27542138, -0.27542138]];
        for (normal, expected) in mesh.normals.iter().zip(expected) {
            assert!((*normal - Vec3::from(expected)).length() < 1e-6, "{normal} is not {expected:?}");
        }
    }

    #[test]
    fn given_normals_go_by_the_inverse_transpose() {
        let mut mesh = FileMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            normals: vec![Vec3::new(0.0, 3.0, 4.0); 3],
            triangles: vec![[0, 1, 2]],
            ..FileMesh::default()
        };
        let stretched = Placement { to_world: DAffine3::from_scale(DVec3::new(1.0, 1.0, 2.0)), ..Placement::IDENTITY };
        let normal = to_scene(&mesh, &stretched, DVec3::ZERO).unwrap().0.normals[0];
        assert!((normal - Vec3::new(0.0, 0.8320503, 0.5547002)).length() < 1e-6, "{normal}");
        // A mirror in x leaves a normal along z, and the order of vertices.
        mesh.normals = vec![Vec3::Z; 3];
        let mirror = Placement { to_world: DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)), ..Placement::IDENTITY };
        let mirrored = to_scene(&mesh, &mirror, DVec3::ZERO).unwrap().0;
        assert_eq!((mirrored.normals[0], mirrored.triangles[0]), (Vec3::Z, [0, 1, 2]));
    }

    #[test]
    fn flipping_turns_faces_and_vertex_normals() {
        let flipped = Placement { flip_normals: true, ..Placement::IDENTITY };
        let plain = to_scene(&tetrahedron(), &Placement::IDENTITY, DVec3::ZERO).unwrap().0;
        let turned = to_scene(&tetrahedron(), &flipped, DVec3::ZERO).unwrap().0;
        assert_eq!(turned.triangles[0], [0, 2, 1]);
        assert_eq!(turned.normals[0], -plain.normals[0]);
    }

    #[test]
    fn triangles_without_area_in_f32_are_left_out() {
        let mut mesh = tetrahedron();
        mesh.triangles.extend([[0, 0, 1], [1, 1, 1]]);
        mesh.positions.push(DVec3::new(1e-60, 0.0, 0.0));
        mesh.triangles.push([0, 4, 1]);
        let (mesh, degenerate) = to_scene(&mesh, &Placement::IDENTITY, DVec3::ZERO).unwrap();
        assert_eq!((mesh.triangles.len(), degenerate), (4, 3));
    }

    #[test]
    fn positions_are_rounded_after_the_origin_is_taken_off() {
        let far = DVec3::new(1e9, -1e9, 0.25);
        let mesh = FileMesh {
            positions: vec![far, far + DVec3::X * 1e-3, far + DVec3::Y * 1e-3],
            triangles: vec![[0, 1, 2]],
            ..FileMesh::default()
        };
        let mesh = to_scene(&mesh, &Placement::IDENTITY, far).unwrap().0;
        assert!((mesh.positions[1].x - 1e-3).abs() < 1e-6 && mesh.positions[0] == Vec3::ZERO);
    }
}
