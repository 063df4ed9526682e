//! Where a scene stands, how large it is, how it is turned and how bright it is change nothing but that.

use crate::build::{image_of, loaded, long, render_wide, scene_path};
use glam::{DMat3, DVec3};
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use tilecast_core::film::Film;
use tilecast_core::world::World;
use tilecast_measure::ztest::{bias, ztest};

/// A similarity.
struct Placement {
    scale: f64,
    turn: DMat3,
    to: DVec3,
}

impl Placement {
    fn point(&self, p: DVec3) -> DVec3 {
        self.turn * (p * self.scale) + self.to
    }
}

/// Every digit that f64 has.
fn digits(p: DVec3) -> String {
    format!("{} {} {}", p.x, p.y, p.z)
}

/// Writes the Cornell box elsewhere: its meshes and camera moved, as whoever made it there would have written them.
fn write_box(folder: &Path, place: &Placement, radiance: f64) {
    let from = scene_path("cornell-box");
    for name in ["room.obj", "left.obj", "right.obj", "blocks.obj"] {
        let mut moved = String::new();
        for line in std::fs::read_to_string(from.join(name)).unwrap().lines() {
            let numbers: Vec<f64> = line.split_whitespace().skip(1).filter_map(|w| w.parse().ok()).collect();
            match line.strip_prefix("v ") {
                Some(_) => writeln!(moved, "v {}", digits(place.point(DVec3::from_slice(&numbers)))).unwrap(),
                None => writeln!(moved, "{line}").unwrap(),
            }
        }
        std::fs::write(folder.join(name), moved).unwrap();
    }
    // The lamp as two triangles, like the rectangle that it is in the scene.
    let corners = [[213.0, 227.0], [343.0, 227.0], [343.0, 332.0], [213.0, 332.0]];
    let mut lamp = String::new();
    for [x, z] in corners {
        writeln!(lamp, "v {}", digits(place.point(DVec3::new(x, 548.5, z)))).unwrap();
    }
    lamp += "f 1 2 3\nf 1 3 4\n";
    std::fs::write(folder.join("lamp.obj"), lamp).unwrap();

    let text = std::fs::read_to_string(from.join("scene.xml")).unwrap();
    let (head, rest) = text.split_once("<lookat").unwrap();
    let (_, rest) = rest.split_once("/>").unwrap();
    let (eye, target) = (place.point(DVec3::new(278.0, 273.0, -800.0)), place.point(DVec3::new(278.0, 273.0, -799.0)));
    let up = place.turn * DVec3::Y;
    let look = format!(r#"<lookat origin="{}" target="{}" up="{}"/>"#, digits(eye), digits(target), digits(up));
    let (before, _) = rest.split_once(r#"<shape type="rectangle" id="lamp-shape">"#).unwrap();
    let [r, g, b] = [18.4f32, 14.0, 6.8].map(|c| f64::from(c) * radiance);
    let lamp = format!(
        r#"<shape type="obj"><string name="filename" value="lamp.obj"/><boolean name="face_normals" value="true"/>
           <ref id="lamp"/><emitter type="area"><rgb name="radiance" value="{r} {g} {b}"/></emitter></shape></scene>"#
    );
    let clip = |name: &str, old: f64| {
        (format!(r#"name="{name}" value="{old}""#), format!(r#"name="{name}" value="{}""#, old * place.scale))
    };
    let mut xml = format!("{head}{look}{before}{lamp}");
    for (old, new) in [clip("near_clip", 10.0), clip("far_clip", 2800.0)] {
        assert!(xml.contains(&old), "{old}");
        xml = xml.replace(&old, &new);
    }
    std::fs::write(folder.join("scene.xml"), xml).unwrap();
}

fn rendered(place: &Placement, radiance: f64, size: [u32; 2], spp: u32, seed: u64) -> Film {
    let folder = tempfile::tempdir().unwrap();
    write_box(folder.path(), place, radiance);
    let (scene, mut settings) = loaded(&folder.path().join("scene.xml"), size, spp);
    settings.seed = seed;
    render_wide(&Arc::new(World::compile(&scene)), &settings)
}

const HERE: Placement = Placement { scale: 1.0, turn: DMat3::IDENTITY, to: DVec3::ZERO };
/// Largest extent of the box.
const EXTENT: f64 = 560.0;

/// z-tests against the original with another seed: single pixels, and the mean of the whole. Seen to
/// fail with rays that start a fixed distance off their surface, and with two axes exchanged for rays that go along x.
#[test]
fn place_size_and_turn_do_not_matter() {
    let (size, spp) = if long() { ([48, 48], 1024) } else { ([16, 16], 256) };
    let original = image_of("original", &rendered(&HERE, 1.0, size, spp, 1));
    let turn = DMat3::from_axis_angle(DVec3::new(0.48, 0.6, 0.64), 1.1);
    let far = DVec3::new(0.6, -0.48, 0.64) * EXTENT;
    let mut places: Vec<Placement> =
        [1e-6, 1e-3, 1e3, 1e6].into_iter().map(|scale| Placement { scale, ..HERE }).collect();
    places.extend([1e3, 1e5, 1e7].map(|sizes| Placement { to: far * sizes, ..HERE }));
    places.push(Placement { turn, ..HERE });
    places.push(Placement { scale: 1e-3, turn, to: far * 1e-3 * 1e6 });
    for (i, place) in places.iter().enumerate() {
        let moved = image_of("moved", &rendered(place, 1.0, size, spp, 2 + i as u64));
        let (z, (biases, _)) = (ztest(&moved, &original).unwrap(), bias(&moved, &original));
        let what = format!("scale {}, moved by {}: {z:?} {biases:?}", place.scale, place.to);
        assert!(z.smallest_p > 0.01 * z.allowed_p && z.within > 0.9 && z.certain_and_different == 0, "{what}");
        // Nine places and three channels: p below 1e-4 happens by chance in one of 370 such tests.
        assert!(biases.iter().all(|b| b.p > 1e-4), "{what}");
    }
}

/// Radiance times a power of two is the image times it, to the bit. Seen to fail with samples clamped at 1000, as it
/// would for any threshold in units of radiance.
#[test]
fn brightness_scales_the_image_exactly() {
    let means = |exponent: i32| {
        let film = rendered(&HERE, libm::exp2(f64::from(exponent)), [12, 12], 32, 5);
        image_of("scaled", &film).rgb
    };
    let original = means(0);
    for exponent in [-40, 40] {
        let scale = libm::exp2f(exponent as f32);
        let expected: Vec<[f32; 3]> = original.iter().map(|rgb| rgb.map(|v| v * scale)).collect();
        assert_eq!(means(exponent), expected, "2^{exponent}");
    }
}
