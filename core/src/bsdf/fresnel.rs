//! Fresnel's equations for unpolarised light.

use glam::Vec3;

/// Reflectance of a dielectric interface and what goes through it.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Share of the light that is reflected.
    pub reflectance: f32,
    /// Cosine of the refracted direction to the normal, on the other side from wo: its sign is opposite to wo's. Zero at
    /// total reflection.
    pub cos_transmitted: f32,
    /// Index of refraction on the far side over that on wo's side.
    pub eta: f32,
}

/// A dielectric met at `cos_theta` (negative: from inside); `eta` is inside over outside.
#[inline(always)]
pub fn dielectric(cos_theta: f32, eta: f32) -> Interface {
    let eta = if cos_theta >= 0.0 { eta } else { 1.0 / eta };
    let cos_i = cos_theta.abs();
    // Snell's law: sin² of the transmitted angle.
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    let cos_t = (1.0 - sin2_t).max(0.0).sqrt();
    let reflectance = if eta == 1.0 {
        0.0
    } else if sin2_t >= 1.0 {
        1.0
    } else {
        let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
        let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
        0.5 * (perpendicular * perpendicular + parallel * parallel)
    };
    Interface { reflectance, cos_transmitted: if cos_theta >= 0.0 { -cos_t } else { cos_t }, eta }
}

/// Reflectance of a conductor with the complex index `eta` − i·`k`, a channel at a time (Born & Wolf 1999, §14.4).
#[inline(always)]
pub fn conductor(cos_theta: f32, eta: Vec3, k: Vec3) -> Vec3 {
    let cos2 = cos_theta * cos_theta;
    let sin2 = 1.0 - cos2;
    let t0 = eta * eta - k * k - Vec3::splat(sin2);
    let a2_plus_b2 = sqrt(t0 * t0 + 4.0 * eta * eta * k * k);
    let a = sqrt(0.5 * (a2_plus_b2 + t0));
    let t1 = a2_plus_b2 + Vec3::splat(cos2);
    let t2 = 2.0 * cos_theta * a;
    let perpendicular = (t1 - t2) / (t1 + t2);
    let t3 = cos2 * a2_plus_b2 + Vec3::splat(sin2 * sin2);
    let t4 = t2 * sin2;
    0.5 * (perpendicular + perpendicular * (t3 - t4) / (t3 + t4))
}

/// Share of uniform diffuse light that a dielectric interface with this relative index reflects: the fits by Egan & Hilgeman
/// 1973 (below one) and d'Eon & Irving 2011 (above), as Mitsuba takes them.
#[inline(always)]
pub fn diffuse_reflectance(eta: f32) -> f32 {
    let inverse = 1.0 / eta;
    if eta < 1.0 {
        0.0636 * inverse + 0.6681 + eta * (0.7099 - 1.4399 * eta)
    } else {
        const FIT: [f32; 6] = [-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317];
        FIT.iter().fold(0.0, |sum, c| sum * inverse + c)
    }
}

#[inline(always)]
fn sqrt(v: Vec3) -> Vec3 {
    Vec3::new(v.x.max(0.0).sqrt(), v.y.max(0.0).sqrt(), v.z.max(0.0).sqrt())
}
