//! Numbers and lists of numbers as Mitsuba writes them in attributes.

/// The entries of a list: anything between commas and blanks.
pub(crate) fn tokens(text: &str) -> Vec<&str> {
    text.split([',', ' ', '\t', '\n', '\r']).filter(|token| !token.is_empty()).collect()
}

/// A finite number.
pub(crate) fn number(text: &str) -> Result<f64, String> {
    text.trim()
        .parse::<f64>()
        .ok()
        .filter(|x| x.is_finite())
        .ok_or_else(|| format!("'{text}' is not a finite number; write one such as 0.5 or 1e-3"))
}

/// A list of finite numbers.
pub(crate) fn numbers(text: &str) -> Result<Vec<f64>, String> {
    tokens(text).into_iter().map(number).collect()
}

/// A whole number.
pub(crate) fn integer(text: &str) -> Result<i64, String> {
    let digits = text.trim();
    let plain = !digits.starts_with('+');
    digits.parse().ok().filter(|_| plain).ok_or_else(|| format!("'{text}' is not an integer; write one such as 64"))
}

/// `true` or `false`, in capitals or not.
pub(crate) fn boolean(text: &str) -> Result<bool, String> {
    match text.to_ascii_lowercase().as_str() {
        "true" => Ok(true),
        "false" => Ok(false),
        _ => Err(format!("'{text}' is neither 'true' nor 'false'")),
    }
}

/// One number for all three components, or three.
pub(crate) fn triple(text: &str) -> Result<[f64; 3], String> {
    match numbers(text)?.as_slice() {
        &[x] => Ok([x; 3]),
        &[x, y, z] => Ok([x, y, z]),
        list => Err(format!("'{text}' has {} numbers; write one or three", list.len())),
    }
}

/// `wavelength:value` pairs, wavelengths in nm and increasing.
pub(crate) fn spectrum(text: &str) -> Result<Vec<(f64, f64)>, String> {
    let pairs = tokens(text).into_iter().map(|token| {
        let (wavelength, value) = token.split_once(':').ok_or_else(|| {
            format!("'{token}' is no wavelength:value pair; write a spectrum as '400:0.1, 500:0.7' or as one number")
        })?;
        Ok((number(wavelength)?, number(value)?))
    });
    check_spectrum(pairs.collect::<Result<_, String>>()?)
}

/// A spectrum file: a wavelength and a value a line, `#` before comments.
pub(crate) fn spectrum_file(text: &str) -> Result<Vec<(f64, f64)>, String> {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or("").trim()).filter(|line| !line.is_empty());
    let pairs = lines.map(|line| match numbers(line)?.as_slice() {
        &[wavelength, value] => Ok((wavelength, value)),
        _ => Err(format!("'{line}' is not a wavelength and a value")),
    });
    check_spectrum(pairs.collect::<Result<_, String>>()?)
}

/// Pairs of a wavelength and a value, if they are a spectrum.
pub(crate) fn check_spectrum(pairs: Vec<(f64, f64)>) -> Result<Vec<(f64, f64)>, String> {
    if pairs.len() < 2 {
        return Err("a spectrum of pairs needs at least two of them; write a constant spectrum as one number".into());
    }
    if let Some(pair) = pairs.windows(2).find(|pair| pair[0].0 >= pair[1].0) {
        return Err(format!("wavelength {} comes after {}; they must increase", pair[1].0, pair[0].0));
    }
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_split_at_commas_and_blanks() {
        assert_eq!(numbers(" 1,2  3 , -4e1 ").unwrap(), [1.0, 2.0, 3.0, -40.0]);
        assert_eq!(triple("0.5").unwrap(), [0.5; 3]);
        assert!(triple("1 2").unwrap_err().contains("one or three"));
    }

    #[test]
    fn what_is_no_number_is_named() {
        for bad in ["", "x", "0.5f", "nan", "inf", "1e999"] {
            assert!(number(bad).is_err(), "{bad}");
        }
        for bad in ["2.0", "+2", "0x10", "99999999999999999999"] {
            assert!(integer(bad).unwrap_err().contains(bad), "{bad}");
        }
        assert!(boolean("1").is_err() && boolean("TRUE").unwrap());
    }

    #[test]
    fn spectra_need_two_increasing_wavelengths() {
        assert_eq!(spectrum("400:0.5 700:0.25").unwrap(), [(400.0, 0.5), (700.0, 0.25)]);
        assert!(spectrum("500:1").unwrap_err().contains("at least two"));
        assert!(spectrum("700:1,400:1").unwrap_err().contains("must increase"));
        assert!(spectrum("1,2,3").unwrap_err().contains("wavelength:value"));
        assert_eq!(spectrum_file("# nm value\n400 0.5\n\n700 1 # end\n").unwrap().len(), 2);
    }
}
