//! Analytic shapes: intersection, surface points and sampling. (Triangles are the hierarchy's own: [`crate::bvh`].)

mod cylinder;
mod disk;
mod hierarchy;
mod sphere;

pub use cylinder::Cylinder;
pub use disk::Disk;
pub use hierarchy::AnalyticBvh;
pub use sphere::Sphere;

use crate::scene::Geometry;
use glam::{Vec2, Vec3};

/// A shape that is traced by its formula.
#[derive(Clone, Debug)]
pub enum Analytic {
    /// A sphere.
    Sphere(Sphere),
    /// A disk or ellipse.
    Disk(Disk),
    /// A cylinder without caps.
    Cylinder(Cylinder),
}

/// A point on an analytic shape.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// In scene coordinates.
    pub position: Vec3,
    /// Bound on its error along each axis.
    pub error: Vec3,
    /// Unit normal, on the outside.
    pub normal: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
}

impl Analytic {
    /// The shape of a geometry that is no mesh.
    pub fn new(geometry: &Geometry) -> Option<Self> {
        match geometry {
            Geometry::Mesh(_) => None,
            Geometry::Sphere { to_world, flip_normals } => Some(Self::Sphere(Sphere::new(to_world, *flip_normals))),
            Geometry::Disk { to_world, flip_normals } => Some(Self::Disk(Disk::new(to_world, *flip_normals))),
            Geometry::Cylinder { to_world, flip_normals } => {
                Some(Self::Cylinder(Cylinder::new(to_world, *flip_normals)))
            }
        }
    }

    /// Corners of a box around it.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        match self {
            Self::Sphere(sphere) => sphere.bounds(),
            Self::Disk(disk) => disk.bounds(),
            Self::Cylinder(cylinder) => cylinder.bounds(),
        }
    }

    /// The smallest t in (0, t_max] where the ray meets it.
    #[inline(always)]
    pub fn intersect(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<f32> {
        match self {
            Self::Sphere(sphere) => sphere.intersect(origin, direction, t_max),
            Self::Disk(disk) => disk.intersect(origin, direction, t_max),
            Self::Cylinder(cylinder) => cylinder.intersect(origin, direction, t_max),
        }
    }

    /// The point of the shape that a ray met near `position`.
    #[inline(always)]
    pub fn point(&self, position: Vec3) -> Point {
        match self {
            Self::Sphere(sphere) => sphere.point(position),
            Self::Disk(disk) => disk.point(position),
            Self::Cylinder(cylinder) => cylinder.point(position),
        }
    }

    /// ∂p/∂u and ∂p/∂v at a point of the shape, as Mitsuba has them.
    pub fn tangents(&self, position: Vec3) -> (Vec3, Vec3) {
        match self {
            Self::Sphere(sphere) => sphere.tangents(position),
            Self::Disk(disk) => disk.tangents(position),
            Self::Cylinder(cylinder) => cylinder.tangents(position),
        }
    }

    /// The normal, where it is the same everywhere.
    pub fn one_normal(&self) -> Option<Vec3> {
        match self {
            Self::Sphere(_) | Self::Cylinder(_) => None,
            Self::Disk(disk) => Some(disk.normal()),
        }
    }

    /// Surface area.
    pub fn area(&self) -> f32 {
        match self {
            Self::Sphere(sphere) => sphere.area(),
            Self::Disk(disk) => disk.area(),
            Self::Cylinder(cylinder) => cylinder.area(),
        }
    }

    /// A point to light `from` from, and its density in solid angle as seen from there; none if none can.
    #[inline(always)]
    pub fn sample(&self, from: Vec3, u: Vec2) -> Option<(Point, f32)> {
        match self {
            Self::Sphere(sphere) => sphere.sample(from, u),
            Self::Disk(disk) => disk.sample(from, u),
            Self::Cylinder(cylinder) => cylinder.sample(from, u),
        }
    }

    /// The density in solid angle of [`Analytic::sample`] at a point of the shape seen from `from`.
    #[inline(always)]
    pub fn pdf(&self, from: Vec3, point: Vec3, normal: Vec3) -> f32 {
        match self {
            Self::Sphere(sphere) => sphere.pdf(from, point, normal),
            Self::Disk(disk) => area_to_solid_angle(1.0 / disk.area(), from, point, normal),
            Self::Cylinder(cylinder) => cylinder.pdf(from, point, normal),
        }
    }
}

/// A density over area turned into one over solid angle seen from `from`: p · d² / |cos θ|. Zero where it is seen edge-on.
#[inline(always)]
pub fn area_to_solid_angle(pdf_area: f32, from: Vec3, point: Vec3, normal: Vec3) -> f32 {
    let towards = point - from;
    let squared = towards.length_squared();
    let projected = towards.dot(normal).abs(); // d · |cos θ|
    if projected > 0.0 { pdf_area * squared * squared.sqrt() / projected } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::warp::uniform_sphere;
    use glam::{Affine3, Quat, Vec2Swizzles};

    fn shapes() -> Vec<Analytic> {
        let to_world = Affine3 {
            matrix3: glam::Mat3::from_quat(Quat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize()) * 0.75,
            translation: Vec3::new(0.3, -1.0, 4.0),
        };
        let elliptic =
            Affine3 { matrix3: to_world.matrix3 * glam::Mat3::from_diagonal(Vec3::new(1.0, 0.6, 1.3)), ..to_world };
        vec![
            Analytic::Sphere(Sphere::new(&to_world, false)),
            Analytic::Disk(Disk::new(&elliptic, false)),
            Analytic::Cylinder(Cylinder::new(&elliptic, false)),
        ]
    }

    /// Light sampling's density integrates to one over the directions that meet the shape, and equals `pdf` there: checked by
    /// comparing E[1/pdf] with the solid angle that uniform directions measure. Fails for a density without the cosine.
    #[test]
    fn sampling_densities_measure_the_solid_angle() {
        for shape in shapes() {
            for from in [Vec3::new(2.0, 0.5, 2.0), Vec3::new(0.4, -1.1, 3.9)] {
                let n = 400u32;
                let grid = || (0..n * n).map(|i| Vec2::new((i / n) as f32 + 0.5, (i % n) as f32 + 0.5) / n as f32);
                let met = grid().filter(|&u| shape.intersect(from, uniform_sphere(u), f32::INFINITY).is_some()).count();
                let solid_angle = 4.0 * std::f64::consts::PI * met as f64 / f64::from(n * n);
                let mut sum = 0.0;
                for u in grid() {
                    let Some((point, pdf)) = shape.sample(from, u) else { continue };
                    let again = shape.pdf(from, point.position, point.normal);
                    // What of a cylinder lies behind its own side fills the same directions once more.
                    let towards = (point.position - from).normalize();
                    let first = shape.intersect(from, towards, f32::INFINITY);
                    if first.is_some_and(|t| t < 0.999 * (point.position - from).length()) {
                        continue;
                    }
                    assert!((pdf - again).abs() <= 2e-3 * pdf, "{shape:?} from {from}: {pdf} and {again}");
                    sum += 1.0 / f64::from(pdf);
                }
                let estimate = sum / f64::from(n * n);
                assert!((estimate - solid_angle).abs() < 0.01 * solid_angle, "{shape:?}: {estimate} for {solid_angle}");
            }
        }
    }

    #[test]
    fn hits_lie_on_the_shape_within_the_error() {
        for shape in shapes() {
            let from = Vec3::new(2.0, 0.5, 2.0);
            let mut checked = 0;
            for i in 0..1000u32 {
                let u = Vec2::new((i % 31) as f32 + 0.5, (i % 37) as f32 + 0.5) / Vec2::new(31.0, 37.0);
                let (target, _) = shape.sample(from, u).unwrap();
                let direction = (target.position - from).normalize();
                let t = shape.intersect(from, direction, f32::INFINITY).or_else(|| {
                    // Exactly at the rim a ray may pass; just inside it may not.
                    let inside = target.position * 0.999 + Vec3::new(0.3, -1.0, 4.0) * 0.001;
                    shape.intersect(from, (inside - from).normalize(), f32::INFINITY)
                });
                if t.unwrap() < (1.0 - 1e-5) * (target.position - from).length() {
                    continue; // the near side of a cylinder
                }
                let point = shape.point(from + direction * t.unwrap());
                let towards = (point.position - target.position).dot(point.normal).abs();
                assert!(towards < 1e-5, "{shape:?}: off by {towards}");
                checked += 1;
            }
            assert!(checked > 300, "{shape:?}: {checked} hits tell little");
        }
    }

    /// From the outside of a cylinder no ray comes back to it, however small or large it is, once it starts beyond the error.
    #[test]
    fn rays_that_leave_do_not_come_back() {
        for scale in [1e-3, 1.0, 1e3] {
            let rotation = glam::Mat3::from_quat(Quat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize());
            let matrix3 = rotation * glam::Mat3::from_diagonal(Vec3::new(1.0, 0.3, 2.0) * scale);
            let cylinder = Cylinder::new(&Affine3 { matrix3, translation: Vec3::new(3.0, -10.0, 40.0) }, false);
            for i in 0..2000u32 {
                let u = Vec2::new((i % 43) as f32 / 43.0, (i % 47) as f32 / 47.0);
                let Some((point, _)) = cylinder.sample(Vec3::new(3.0, -10.0, 40.0) + Vec3::splat(5e3), u) else {
                    continue;
                };
                let out = crate::frame::Frame::around(point.normal).to_world(crate::warp::cosine_hemisphere(u.yx()));
                let offset = point.normal * (point.normal.abs().dot(point.error));
                let hit = cylinder.intersect(point.position + offset, out, f32::INFINITY);
                assert!(hit.is_none(), "scale {scale}: {point:?} is met again at {hit:?}");
            }
        }
    }
}
