//! The tags inside `<transform>`, composed in f64 in Mitsuba's order: what is written last acts last.

use super::element::{Attribute, Element, Wrong};
use super::values;

use glam::{DMat3, DMat4, DVec3, DVec4};

/// The matrix of one tag.
///
/// # Errors
/// Unknown tags or attributes and values out of range.
pub(crate) fn matrix_of(element: &Element) -> Result<DMat4, Wrong<'_>> {
    match element.tag.as_str() {
        "translate" => {
            element.check(&[], &["x", "y", "z", "value"])?;
            Ok(DMat4::from_translation(vector(element, 0.0)?))
        }
        "scale" => {
            element.check(&[], &["x", "y", "z", "value"])?;
            Ok(DMat4::from_scale(vector(element, 1.0)?))
        }
        "rotate" => {
            element.check(&["angle"], &["x", "y", "z", "value"])?;
            let axis = vector(element, 0.0)?;
            if axis == DVec3::ZERO {
                return Err((None, "a rotation needs an axis; write x=\"1\", y=\"1\" or z=\"1\"".into()));
            }
            let angle = element.get("angle").map_or(Ok(0.0), |a| parse(a, values::number))?;
            Ok(rotation(axis, angle.to_radians()))
        }
        "lookat" => {
            element.check(&["origin", "target"], &["up"])?;
            look_at(element)
        }
        "matrix" => {
            element.check(&["value"], &[])?;
            element.get("value").map_or(Ok(DMat4::IDENTITY), |value| parse(value, matrix))
        }
        tag => {
            let hint = crate::load::error::did_you_mean(tag, ["translate", "rotate", "scale", "lookat", "matrix"]);
            let message =
                format!("<{tag}> is no transformation{hint}; there are translate, rotate, scale, lookat, matrix");
            Err((None, message))
        }
    }
}

fn parse<T>(attribute: &Attribute, read: impl Fn(&str) -> Result<T, String>) -> Result<T, Wrong<'_>> {
    read(&attribute.value).map_err(|message| (Some(attribute), message))
}

/// x, y and z, or `value` for all of them.
pub(crate) fn vector(element: &Element, missing: f64) -> Result<DVec3, Wrong<'_>> {
    let parts = ["x", "y", "z"].map(|name| element.get(name));
    if let Some(value) = element.get("value") {
        if parts.iter().any(Option::is_some) {
            return Err((Some(value), "either value or x, y and z can be given, not both".into()));
        }
        return parse(value, values::triple).map(DVec3::from);
    }
    let mut vector = [missing; 3];
    for (component, attribute) in vector.iter_mut().zip(parts) {
        if let Some(attribute) = attribute {
            *component = parse(attribute, values::number)?;
        }
    }
    Ok(vector.into())
}

/// Rodrigues' rotation about `axis`, which Mitsuba does not normalise: a longer axis also scales.
fn rotation(axis: DVec3, angle: f64) -> DMat4 {
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
    DMat4::from_mat3(DMat3::IDENTITY * cos + cross * sin + outer * (1.0 - cos))
}

/// A frame at `origin` whose z axis points to `target`, y as near to `up` as can be, x to the left of them.
fn look_at(element: &Element) -> Result<DMat4, Wrong<'_>> {
    let read = |name: &str| match element.get(name) {
        Some(attribute) => parse(attribute, |text| match values::numbers(text)?.as_slice() {
            &[x, y, z] => Ok(DVec3::new(x, y, z)),
            list => Err(format!("'{text}' has {} numbers; write three", list.len())),
        }),
        None => Ok(DVec3::ZERO),
    };
    let (origin, target, up) = (read("origin")?, read("target")?, read("up")?);
    let direction = (target - origin).normalize();
    let up = if up == DVec3::ZERO { any_perpendicular(direction) } else { up };
    let left = up.cross(direction).normalize();
    let matrix = DMat4::from_cols(
        left.extend(0.0),
        direction.cross(left).extend(0.0),
        direction.extend(0.0),
        origin.extend(1.0),
    );
    if matrix.is_finite() {
        Ok(matrix)
    } else {
        let message = "origin and target must differ, and up must not be parallel to the direction between them";
        Err((None, message.into()))
    }
}

/// The first vector of the basis of Duff et al. 2017, "Building an Orthonormal Basis, Revisited", listing 3.
fn any_perpendicular(n: DVec3) -> DVec3 {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    DVec3::new(1.0 + sign * n.x * n.x * a, sign * n.x * n.y * a, -sign * n.x)
}

/// 16 or 9 numbers, row by row.
fn matrix(text: &str) -> Result<DMat4, String> {
    let list = values::numbers(text)?;
    match <[f64; 16]>::try_from(list.as_slice()) {
        Ok(rows) if rows[12..] == [0.0, 0.0, 0.0, 1.0] => Ok(DMat4::from_cols_array(&rows).transpose()),
        Ok(_) => Err("the last row of the matrix must be 0 0 0 1".into()),
        Err(_) if list.len() == 9 => {
            let row = |i: usize| DVec4::new(list[3 * i], list[3 * i + 1], list[3 * i + 2], 0.0);
            Ok(DMat4::from_cols(row(0), row(1), row(2), DVec4::W).transpose())
        }
        Err(_) => Err(format!("the matrix has {} numbers; write 16 or 9, row by row", list.len())),
    }
}
