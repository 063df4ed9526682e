//! Cameras.

use glam::Affine3;
use serde::{Deserialize, Serialize};

/// A camera: where it stands and how wide it sees. Film size is a setting ([`crate::settings::Film`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Sensor {
    /// A pinhole or a lens that looks along +z of its own space, x to the left of the picture, y up, as Mitsuba's `perspective`.
    Perspective {
        /// Camera space to scene coordinates; a scale in it is removed from the directions, as in Mitsuba.
        to_world: Affine3,
        /// Field of view in degrees, along `fov_axis`.
        fov_degrees: f32,
        /// What the field of view measures.
        fov_axis: FovAxis,
        /// Added to film coordinates, as fractions of the film's width and height: a positive one moves the picture to the
        /// left and up.
        principal_point_offset: [f32; 2],
        /// Surfaces nearer than this along the camera's axis are not seen.
        near_clip: f32,
        /// Surfaces farther than this along the camera's axis are not seen.
        far_clip: f32,
        /// Blurs what is out of focus, as Mitsuba's `thinlens`; none for a pinhole.
        lens: Option<Lens>,
    },
    /// Parallel rays along +z: the film is the square [−1, 1]² of x and y, or as much of its height as the film's shape asks
    /// for, as Mitsuba's `orthographic`.
    Orthographic {
        /// Camera space to scene coordinates; its scale in x and y is that of the picture.
        to_world: Affine3,
        /// Surfaces nearer than this along the camera's axis are not seen.
        near_clip: f32,
        /// Surfaces farther than this along the camera's axis are not seen.
        far_clip: f32,
    },
}

/// A thin lens, uniformly lit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// In scene units.
    pub aperture_radius: f32,
    /// Distance of the plane in focus along the camera's axis.
    pub focus_distance: f32,
}

/// The extent of the film that a field of view spans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FovAxis {
    /// The width.
    X,
    /// The height.
    Y,
    /// The diagonal.
    Diagonal,
    /// The smaller of width and height.
    Smaller,
    /// The larger of them.
    Larger,
}
