//! Files of version below 2: names in camelCase, texture offsets and scales as four numbers. Upgraded as Mitsuba 3 does.

use super::document::{Object, Property, Span, Tag, Value};
use glam::{DMat4, DVec3};

/// Gives an object's properties their present names.
///
/// # Errors
/// A texture offset or scale that is no number, with its place.
pub(crate) fn from_version_1(object: &mut Object) -> Result<(), (Span, String)> {
    for property in &mut object.properties {
        property.name = property.name.take().map(|name| snake_case(&name));
        if object.tag == Tag::Bsdf
            && object.plugin == "diffuse"
            && property.name.as_deref() == Some("diffuse_reflectance")
        {
            property.name = Some("reflectance".into());
        }
    }
    let mut offset_and_scale = [0.0, 0.0, 1.0, 1.0];
    let mut span = None;
    for (number, name) in offset_and_scale.iter_mut().zip(["uoffset", "voffset", "uscale", "vscale"]) {
        let Some(i) = object.properties.iter().position(|p| p.name.as_deref() == Some(name)) else { continue };
        let property = object.properties.remove(i);
        *number = match property.value {
            Value::Float(x) => x,
            Value::Integer(i) => i as f64,
            other => return Err((property.span, format!("'{name}' is a number, not a {}", other.kind()))),
        };
        span = Some(property.span);
    }
    if let Some(span) = span {
        let [u, v, us, vs] = offset_and_scale;
        let to_uv = DMat4::from_scale(DVec3::new(us, vs, 1.0)) * DMat4::from_translation(DVec3::new(u, v, 0.0));
        object.properties.push(Property { name: Some("to_uv".into()), value: Value::Transform(to_uv), span });
    }
    Ok(())
}

/// `intIOR` to `int_ior`: an underscore where a capital follows a small letter, and the run of capitals made small.
fn snake_case(name: &str) -> String {
    let mut result = String::with_capacity(name.len() + 4);
    let (mut after_small, mut in_run) = (false, false);
    for c in name.chars() {
        in_run = c.is_ascii_uppercase() && (after_small || in_run);
        if in_run && after_small {
            result.push('_');
        }
        result.push(if in_run { c.to_ascii_lowercase() } else { c });
        after_small = c.is_ascii_lowercase();
    }
    result
}

#[cfg(test)]
mod tests {
    use super::snake_case;

    #[test]
    fn capitals_after_small_letters_become_underscores() {
        for (old, new) in [
            ("toWorld", "to_world"),
            ("intIOR", "int_ior"),
            ("diffuseReflectance", "diffuse_reflectance"),
            ("sampleCount", "sample_count"),
            ("radiance", "radiance"),
            ("Kd", "Kd"),
        ] {
            assert_eq!(snake_case(old), new);
        }
    }
}
