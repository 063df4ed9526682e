//! How large and how bright a scene is.

use super::{Emitter, Geometry, Image, Instance, Scene, Shape, Texels, Texture, TextureId};
use glam::Vec3;
use std::f32::consts::PI;

/// Points of light have no largest radiance; it is taken at this fraction of the scene's radius from them.
const POINT_DISTANCE: f32 = 1e-3;

impl Scene {
    /// The smallest box around all surfaces, in scene coordinates; none if there is no surface.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let of_shape = |geometry: &Geometry| match geometry {
            Geometry::Mesh(id) => {
                let mesh = &self.meshes[id.0 as usize];
                let used = mesh.triangles.iter().flatten().map(|&i| mesh.positions[i as usize]);
                used.map(|p| (p, p)).reduce(join)
            }
            // Along each axis a sphere reaches as far as the matrix' row is long, a disk as far as its first two columns.
            Geometry::Sphere { to_world, .. } => {
                let m = to_world.matrix3;
                Some(around(to_world.translation, m.x_axis * m.x_axis + m.y_axis * m.y_axis + m.z_axis * m.z_axis))
            }
            Geometry::Disk { to_world, .. } => {
                let m = to_world.matrix3;
                Some(around(to_world.translation, m.x_axis * m.x_axis + m.y_axis * m.y_axis))
            }
            Geometry::Cylinder { to_world, .. } => {
                let m = to_world.matrix3;
                let squares = m.x_axis * m.x_axis + m.y_axis * m.y_axis;
                Some(join(around(to_world.translation, squares), around(to_world.translation + m.z_axis, squares)))
            }
        };
        let of_shapes = |shapes: &[Shape]| shapes.iter().filter_map(|shape| of_shape(&shape.geometry)).reduce(join);
        let groups: Vec<_> = self.groups.iter().map(|group| of_shapes(&group.shapes)).collect();
        let of_instance = |instance: &Instance| {
            let (min, max) = groups[instance.group.0 as usize]?;
            let matrix = instance.to_world.matrix3;
            let half = 0.5 * max - 0.5 * min;
            let reach = matrix.x_axis.abs() * half.x + matrix.y_axis.abs() * half.y + matrix.z_axis.abs() * half.z;
            let centre = instance.to_world.transform_point3(0.5 * min + 0.5 * max);
            Some((centre - reach, centre + reach))
        };
        of_shapes(&self.shapes).into_iter().chain(self.instances.iter().filter_map(of_instance)).reduce(join)
    }

    /// The largest radiance a light of this scene sends out, from which the film's scale follows
    /// ([`crate::film::scale_exponent`]). For lights at a point it is taken at a thousandth of the scene's radius.
    pub fn brightest_radiance(&self) -> f32 {
        let radius = self.bounds().map_or(1.0, |(min, max)| 0.5 * (max - min).length());
        let distance = if radius > 0.0 { POINT_DISTANCE * radius } else { 1.0 };
        let of_emitters = self.emitters.iter().map(|emitter| match emitter {
            Emitter::Constant { radiance } => radiance.max_element(),
            Emitter::Point { intensity, .. } => intensity.max_element() / (distance * distance),
            Emitter::Directional { irradiance, .. } => irradiance.max_element(),
            Emitter::Envmap { image, scale, .. } => self.images[image.0 as usize].largest_value() * scale,
            Emitter::Spot { intensity, texture, .. } => {
                let factor = texture.map_or(1.0, |id| self.largest_value(id));
                intensity.max_element() * factor / (distance * distance)
            }
            Emitter::Projector { irradiance, scale, half_extent: [x, y], .. } => {
                // In the corners of the image the intensity is π / cos³θ times its value.
                let square = 1.0 + x * x + y * y;
                PI * self.largest_value(*irradiance) * scale * square * square.sqrt() / (distance * distance)
            }
        });
        let of_shapes = self.shapes.iter().filter_map(|shape| shape.radiance).map(|id| self.largest_value(id));
        of_emitters.chain(of_shapes).fold(0.0, |a, b| if b > a { b } else { a })
    }

    /// An upper bound of a texture's values.
    fn largest_value(&self, id: TextureId) -> f32 {
        match &self.textures[id.0 as usize] {
            Texture::Constant(rgb) => rgb.max_element(),
            Texture::Checkerboard { color0, color1, .. } => {
                let (a, b) = (self.largest_value(*color0), self.largest_value(*color1));
                if b > a { b } else { a }
            }
            Texture::Bitmap { image, scale, .. } => self.images[image.0 as usize].largest_value() * scale,
            Texture::MeshAttribute { name, scale } => {
                let attributes = self.meshes.iter().flat_map(|mesh| &mesh.attributes).filter(|a| a.name == *name);
                let values = attributes.flat_map(|a| (0..a.values.len()).map(|i| a.values.at(i).max_element()));
                scale * values.fold(0.0, |a, b| if b > a { b } else { a })
            }
        }
    }
}

impl Image {
    /// An upper bound of the pixels' linear values: sRGB decoding makes no value larger.
    fn largest_value(&self) -> f32 {
        match &self.texels {
            Texels::Grey8 { data, .. } | Texels::Rgb8 { data, .. } => {
                f32::from(data.iter().copied().max().unwrap_or(0)) / 255.0
            }
            Texels::Grey32(data) | Texels::Rgb32(data) => {
                data.iter().copied().fold(0.0, |a, b| if b > a { b } else { a })
            }
        }
    }
}

fn join(a: (Vec3, Vec3), b: (Vec3, Vec3)) -> (Vec3, Vec3) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// The box around a centre whose reach along each axis is given squared.
fn around(centre: Vec3, squares: Vec3) -> (Vec3, Vec3) {
    let reach = Vec3::new(squares.x.sqrt(), squares.y.sqrt(), squares.z.sqrt());
    (centre - reach, centre + reach)
}
