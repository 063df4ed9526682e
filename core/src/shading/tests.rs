//! Truths about materials on shapes: bent and oriented frames are Mitsuba's, chance blends without bias.

mod mitsuba;

use super::*;
use crate::scene::{
    Bend, Distribution, FilterType, FovAxis, Geometry as ShapeGeometry, Image, ImageId, Mesh, MeshId, Sensor, Shape,
    Texels, WrapMode,
};
use crate::world::World;
use glam::{Affine2, Affine3, Mat3, Vec3};
use std::sync::Arc;

const BEND: Bend = Bend { flip_invalid_normals: true, use_shadowing_function: true };
const MATERIALS: [&str; 6] = ["aniso", "normal", "normal plain", "bump", "two bump", "normal two"];

/// A scene of one shape with one of the materials that the values were made with.
fn scene(shape: &str, material: usize) -> Scene {
    let grey = |x| Texture::Constant(Vec3::splat(x));
    let bitmap = Texture::Bitmap {
        image: ImageId(0),
        to_uv: Affine2::IDENTITY,
        filter: FilterType::Bilinear,
        wrap: WrapMode::Repeat,
        scale: 1.0,
    };
    let textures = vec![
        grey(0.1),
        grey(0.5),
        Texture::Constant(Vec3::new(0.14, 0.37, 1.44)),
        Texture::Constant(Vec3::new(3.98, 2.38, 1.6)),
        grey(1.0),
        Texture::Constant(Vec3::new(0.8, 0.3, 0.7)),
        bitmap,
        grey(0.3),
    ];
    // Mitsuba 3.9.1 takes the tangent of a bumped frame from the wrong space (later versions do not), so the metal on bumps
    // has none.
    let metal = |alpha_u, alpha_v| Bsdf::RoughConductor {
        distribution: Distribution::Ggx,
        alpha_u: TextureId(alpha_u),
        alpha_v: TextureId(alpha_v),
        eta: TextureId(2),
        k: TextureId(3),
        specular_reflectance: TextureId(4),
    };
    let (brushed, round) = (metal(0, 1), metal(7, 7));
    let both = |id| Bsdf::TwoSided { front: BsdfId(id), back: BsdfId(id) };
    let normal = |bend, nested| Bsdf::NormalMap { normalmap: TextureId(5), bend, nested: BsdfId(nested) };
    let plain = Bend { use_shadowing_function: false, ..BEND };
    let bump = Bsdf::BumpMap { texture: TextureId(6), scale: 0.3, bend: BEND, nested: BsdfId(0) };
    let bsdfs = match material {
        0 => vec![brushed],
        1 => vec![brushed, normal(BEND, 0)],
        2 => vec![brushed, normal(plain, 0)],
        3 => vec![round, bump],
        4 => vec![round, bump, both(1)],
        _ => vec![brushed, both(0), normal(BEND, 1)],
    };
    let rotation = Mat3::from_axis_angle(Vec3::new(0.48, 0.6, 0.64), 40f32.to_radians());
    let to_world = |scale: Vec3| Affine3::from_mat3(rotation * Mat3::from_diagonal(scale));
    let similarity = to_world(Vec3::splat(1.5));
    let geometry = match shape {
        "rectangle" => ShapeGeometry::Mesh(MeshId(0)),
        "sphere" => ShapeGeometry::Sphere { to_world: similarity, flip_normals: false },
        _ => ShapeGeometry::Disk { to_world: similarity, flip_normals: false },
    };
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let stretched = to_world(Vec3::new(2.0, 1.0, 1.0));
    let mesh = Mesh {
        positions: corners.iter().map(|&(x, y)| stretched.transform_point3(Vec3::new(x, y, 0.0))).collect(),
        uvs: corners.iter().map(|&(x, y)| Vec2::new(0.5 + 0.5 * x, 0.5 + 0.5 * y)).collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    let heights = Image { width: 3, height: 2, texels: Texels::Grey32(vec![0.1, 0.5, 0.3, 0.9, 0.2, 0.4]) };
    Scene {
        sensor: Sensor::Perspective {
            to_world: Affine3::IDENTITY,
            fov_degrees: 45.0,
            fov_axis: FovAxis::X,
            principal_point_offset: [0.0; 2],
            near_clip: 0.1,
            far_clip: 100.0,
            lens: None,
        },
        shapes: vec![Shape { name: shape.into(), geometry, bsdf: BsdfId(bsdfs.len() as u32 - 1), radiance: None }],
        groups: Vec::new(),
        instances: Vec::new(),
        bsdfs,
        textures,
        emitters: Vec::new(),
        meshes: vec![Arc::new(mesh)],
        images: vec![Arc::new(heights)],
        origin: [0.0; 3],
    }
}

/// The world, and its surface above (or at) (0.3, 0.2, 0) of the shape's own space.
fn world(scene: &Scene) -> (World, Surface) {
    scene.validate().unwrap();
    let world = World::compile(scene);
    let surface = match &scene.shapes[0].geometry {
        ShapeGeometry::Mesh(_) => world.geometry.triangle_surface(0, Vec2::new(0.05, 0.6)),
        ShapeGeometry::Sphere { to_world, .. } => {
            let local = Vec3::new(0.3, 0.2, 0.87f32.sqrt());
            world.geometry.analytic_surface(0, to_world.transform_point3(local))
        }
        ShapeGeometry::Disk { to_world, .. } | ShapeGeometry::Cylinder { to_world, .. } => {
            world.geometry.analytic_surface(0, to_world.transform_point3(Vec3::new(0.3, 0.2, 0.0)))
        }
    };
    (world, surface)
}

/// Fails if the tangents do not follow the texture coordinates, or if a back side mirrors a map the other way. The highlights
/// are a tenth wide, so that they multiply rounding by ten: 10^-3.
#[test]
fn bent_frames_are_those_of_mitsuba() {
    for &(shape, material, values) in mitsuba::VALUES {
        let index = MATERIALS.iter().position(|name| *name == material).unwrap();
        let (world, surface) = world(&scene(shape, index));
        let [wo, wi, theirs] = values.map(Vec3::from_array);
        let shading = world.materials.at(&world.geometry, &world.textures, &surface, wo, &mut 0.5);
        let ours = shading.eval(shading.frame.to_local(wo), shading.frame.to_local(wi)).value;
        let off = (ours - theirs).abs().max_element();
        assert!(off <= 1e-3 * theirs.max_element(), "{material} on {shape}: {ours}, Mitsuba {theirs}");
    }
}

#[test]
fn bent_samples_are_those_of_the_evaluation() {
    for (material, name) in MATERIALS.iter().enumerate() {
        let (world, surface) = world(&scene("sphere", material));
        let frame = surface.frame;
        for i in 0..4096u32 {
            let part = |shift: u32| (i >> shift & 15) as f32 / 16.0;
            let wo = frame.to_world(crate::warp::around_z(0.1 + 0.8 * part(0), 0.3));
            let shading = world.materials.at(&world.geometry, &world.textures, &surface, wo, &mut 0.5);
            let wo = shading.frame.to_local(wo);
            let Some(sample) = shading.sample(wo, 0.5, Vec2::new(part(4), part(8))) else { continue };
            let Evaluation { value, pdf } = shading.eval(wo, sample.wi);
            let off = (sample.weight * pdf - value).abs().max_element();
            assert!(off <= 2e-3 * value.max_element(), "{name}: {sample:?} {value} {pdf}");
        }
    }
}

/// Mixtures in a mixture: the shares of numbers that end in each leaf are the products of the weights.
#[test]
fn blends_and_masks_choose_by_their_weights() {
    let mut scene = scene("disk", 0);
    scene.textures.extend([0.25, 0.4].map(|x| Texture::Constant(Vec3::splat(x))));
    scene.bsdfs = vec![
        Bsdf::Diffuse { reflectance: TextureId(1) },
        Bsdf::Plastic {
            eta: 1.5,
            nonlinear: false,
            diffuse_reflectance: TextureId(1),
            specular_reflectance: TextureId(4),
        },
        Bsdf::BlendBsdf { weight: TextureId(8), nested: [BsdfId(0), BsdfId(1)] },
        Bsdf::Mask { opacity: TextureId(9), nested: BsdfId(2) },
    ];
    scene.shapes[0].bsdf = BsdfId(3);
    let (world, surface) = world(&scene);
    let n = 10_000;
    let (mut diffuse, mut plastic, mut rest) = (0, 0, 0.0);
    for i in 0..n {
        let mut lobe = (i as f32 + 0.5) / n as f32;
        match world.materials.at(&world.geometry, &world.textures, &surface, surface.normal, &mut lobe).closure {
            Closure::Diffuse(_) => diffuse += 1,
            Closure::Plastic(_) => plastic += 1,
            closure => assert!(matches!(closure, Closure::Null)),
        }
        assert!((0.0..1.0).contains(&lobe));
        rest += f64::from(lobe) / f64::from(n);
    }
    assert!((diffuse - 3000i32).abs() <= 1 && (plastic - 1000i32).abs() <= 1, "{diffuse} and {plastic}");
    assert!((rest - 0.5).abs() < 1e-3, "the rest of the number has the mean {rest}");
}

#[test]
fn a_map_in_a_map_is_refused() {
    let mut scene = scene("disk", 1);
    scene.bsdfs.push(Bsdf::NormalMap { normalmap: TextureId(5), bend: BEND, nested: BsdfId(1) });
    assert!(scene.validate().is_err());
}
