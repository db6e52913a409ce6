// Arithmetic of float64 in integers: the bits of IEEE 754, rounded to nearest, on every device.
//
// WGSL has no 64-bit floats, and does not say how it rounds 32-bit ones; integers are exact. A double
// is a vec2u of its low and its high word. Numbers below 2^-1022 count as 0. Infinity arises where a
// result is too large, and may be compared only; there is no NaN.
//
// Sources: IEEE 754-2019; Knuth, "The Art of Computer Programming", volume 2, section 4.3.1, for the
// quotient: digits that are estimated and corrected.

const SIGN: u32 = 0x80000000u;
const INFINITE = vec2u(0u, 0x7ff00000u);
const BIAS: i32 = 1023;

// The bits of the exponent, 0 for a number that counts as 0.
fn exponent_bits(a: vec2u) -> i32 {
    return i32((a.y >> 20u) & 0x7ffu);
}

fn negated(a: vec2u) -> vec2u {
    return vec2u(a.x, a.y ^ SIGN);
}

fn magnitude(a: vec2u) -> vec2u {
    return vec2u(a.x, a.y & ~SIGN);
}

// 64-bit integers

fn is_less64(a: vec2u, b: vec2u) -> bool {
    return a.y < b.y || (a.y == b.y && a.x < b.x);
}

fn sum64(a: vec2u, b: vec2u) -> vec2u {
    let low = a.x + b.x;
    return vec2u(low, a.y + b.y + u32(low < a.x));
}

fn difference64(a: vec2u, b: vec2u) -> vec2u {
    return vec2u(a.x - b.x, a.y - b.y - u32(a.x < b.x));
}

// By 0 to 63 bits.
fn left64(a: vec2u, count: u32) -> vec2u {
    if count == 0u {
        return a;
    }
    if count >= 32u {
        return vec2u(0u, a.x << (count - 32u));
    }
    return vec2u(a.x << count, (a.y << count) | (a.x >> (32u - count)));
}

// By any number of bits; the last bit of the result is 1 if a bit that was shifted out is.
fn right64(a: vec2u, count: u32) -> vec2u {
    if count == 0u {
        return a;
    }
    if count >= 64u {
        return vec2u(u32((a.x | a.y) != 0u), 0u);
    }
    if count >= 32u {
        let above = count - 32u;
        let lost = a.x | select(a.y << (32u - above), 0u, above == 0u);
        return vec2u((a.y >> above) | u32(lost != 0u), 0u);
    }
    let lost = a.x << (32u - count);
    return vec2u((a.x >> count) | (a.y << (32u - count)) | u32(lost != 0u), a.y >> count);
}

// The product of two words.
fn product64(a: u32, b: u32) -> vec2u {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let left = (a >> 16u) * (b & 0xffffu);
    let right = (a & 0xffffu) * (b >> 16u);
    let middle = (low >> 16u) + (left & 0xffffu) + (right & 0xffffu);
    let high = (a >> 16u) * (b >> 16u) + (left >> 16u) + (right >> 16u) + (middle >> 16u);
    return vec2u((low & 0xffffu) | (middle << 16u), high);
}

// Parts of doubles

// The 53 bits of a number that is not 0.
fn mantissa(a: vec2u) -> vec2u {
    return vec2u(a.x, (a.y & 0xfffffu) | 0x100000u);
}

// Round a number of 64 bits, the first of which is 1, to 53; its last bit may stand for lost ones.
// `exponent` is that of a double with these bits.
fn double_of(sign: u32, exponent: i32, bits: vec2u) -> vec2u {
    if exponent <= 0 {
        return vec2u(0u, sign);
    }
    if exponent >= 2047 {
        return vec2u(0u, sign | INFINITE.y);
    }
    let kept = vec2u((bits.x >> 11u) | (bits.y << 21u), bits.y >> 11u);
    let rest = bits.x & 0x7ffu;
    let is_up = rest > 0x400u || (rest == 0x400u && (kept.x & 1u) == 1u);
    // The first bit of what is kept adds 1 to the exponent, as does a carry.
    let whole = vec2u(kept.x, kept.y + (u32(exponent - 1) << 20u));
    let result = sum64(whole, vec2u(u32(is_up), 0u));
    return vec2u(result.x, result.y | sign);
}

// Arithmetic

fn double_sum(a: vec2u, b: vec2u) -> vec2u {
    let is_swapped = is_less64(magnitude(a), magnitude(b));
    let large = select(a, b, is_swapped);
    let small = select(b, a, is_swapped);
    let exponent = exponent_bits(large);
    if exponent_bits(small) == 0 {
        return select(large, vec2u(0u, a.y & b.y & SIGN), exponent == 0);
    }
    // 53 bits after one for a carry, and ten below.
    let shift = u32(exponent - exponent_bits(small));
    let more = left64(mantissa(large), 10u);
    let less = right64(left64(mantissa(small), 10u), shift);
    var bits = sum64(more, less);
    if ((a.y ^ b.y) & SIGN) != 0u {
        bits = difference64(more, less);
        if (bits.x | bits.y) == 0u {
            return vec2u();
        }
    }
    let zeros = select(countLeadingZeros(bits.y), 32u + countLeadingZeros(bits.x), bits.y == 0u);
    return double_of(large.y & SIGN, exponent + 1 - i32(zeros), left64(bits, zeros));
}

fn double_difference(a: vec2u, b: vec2u) -> vec2u {
    return double_sum(a, negated(b));
}

fn double_product(a: vec2u, b: vec2u) -> vec2u {
    let sign = (a.y ^ b.y) & SIGN;
    if exponent_bits(a) == 0 || exponent_bits(b) == 0 {
        return vec2u(0u, sign);
    }
    // 128 bits, of which the first or the second is 1.
    let x = left64(mantissa(a), 11u);
    let y = left64(mantissa(b), 11u);
    let low = product64(x.x, y.x);
    let left = product64(x.x, y.y);
    let right = product64(x.y, y.x);
    let first = low.y + left.x;
    let second = first + right.x;
    let carry = u32(first < low.y) + u32(second < first);
    var high = sum64(product64(x.y, y.y), vec2u(left.y, 0u));
    high = sum64(sum64(high, vec2u(right.y, 0u)), vec2u(carry, 0u));
    var rest = second;
    var exponent = exponent_bits(a) + exponent_bits(b) - BIAS + 1;
    if (high.y & SIGN) == 0u {
        high = vec2u((high.x << 1u) | (rest >> 31u), (high.y << 1u) | (high.x >> 31u));
        rest <<= 1u;
        exponent -= 1;
    }
    high.x |= u32((rest | low.x) != 0u);
    return double_of(sign, exponent, high);
}

fn as_float(a: vec2u) -> f32 {
    return f32(a.y) * 0x1p32 + f32(a.x);
}

struct Digit {
    // 18 bits of a quotient.
    value: u32,
    remainder: vec2u,
}

// The next digit of remainder / divisor, from an estimate that is off by less than 1: floats have
// 24 bits, and the few operations that it takes lose less than six of them.
fn next_digit(remainder: vec2u, divisor: vec2u, inverse: f32) -> Digit {
    var value = u32(as_float(remainder) * inverse * 0x1p18);
    let low = product64(value, divisor.x);
    let taken = vec2u(low.x, low.y + value * divisor.y);
    // Modulo 2^64, which the result is far below.
    var rest = difference64(left64(remainder, 18u), taken);
    if (rest.y & SIGN) != 0u {
        rest = sum64(rest, divisor);
        value -= 1u;
    } else if !is_less64(rest, divisor) {
        rest = difference64(rest, divisor);
        value += 1u;
    }
    return Digit(value, rest);
}

fn double_quotient(a: vec2u, b: vec2u) -> vec2u {
    let sign = (a.y ^ b.y) & SIGN;
    if exponent_bits(a) == 0 {
        return vec2u(0u, sign);
    }
    if exponent_bits(b) == 0 {
        return vec2u(0u, sign | INFINITE.y);
    }
    // 1, then three digits: 55 bits.
    let divisor = mantissa(b);
    var dividend = mantissa(a);
    var exponent = exponent_bits(a) - exponent_bits(b) + BIAS;
    if is_less64(dividend, divisor) {
        dividend = left64(dividend, 1u);
        exponent -= 1;
    }
    let inverse = 1.0 / as_float(divisor);
    let one = next_digit(difference64(dividend, divisor), divisor, inverse);
    let two = next_digit(one.remainder, divisor, inverse);
    let three = next_digit(two.remainder, divisor, inverse);
    let high = ((0x40000u | one.value) << 13u) | (two.value >> 5u);
    let low = (two.value << 27u) | (three.value << 9u);
    let is_inexact = (three.remainder.x | three.remainder.y) != 0u;
    return double_of(sign, exponent, vec2u(low | u32(is_inexact), high));
}

// a * 2^power.
fn scaled(a: vec2u, power: i32) -> vec2u {
    let exponent = exponent_bits(a) + power;
    if exponent_bits(a) == 0 || exponent <= 0 {
        return vec2u(0u, a.y & SIGN);
    }
    if exponent >= 2047 {
        return vec2u(0u, (a.y & SIGN) | INFINITE.y);
    }
    return vec2u(a.x, (a.y & ~INFINITE.y) | (u32(exponent) << 20u));
}

// Comparisons

// Integers in the order of doubles.
fn ordered(a: vec2u) -> vec2u {
    if exponent_bits(a) == 0 {
        return vec2u(0u, SIGN);
    }
    return select(vec2u(a.x, a.y | SIGN), ~a, (a.y & SIGN) != 0u);
}

fn is_less(a: vec2u, b: vec2u) -> bool {
    return is_less64(ordered(a), ordered(b));
}

fn smaller(a: vec2u, b: vec2u) -> vec2u {
    return select(a, b, is_less(b, a));
}

fn larger(a: vec2u, b: vec2u) -> vec2u {
    return select(a, b, is_less(a, b));
}

// Floats

// A finite float as a double.
fn widened(x: f32) -> vec2u {
    let bits = bitcast<u32>(x);
    let sign = bits & SIGN;
    var exponent = (bits >> 23u) & 0xffu;
    var rest = bits & 0x7fffffu;
    if exponent == 0u {
        if rest == 0u {
            return vec2u(0u, sign);
        }
        let shift = countLeadingZeros(rest) - 8u;
        rest = (rest << shift) & 0x7fffffu;
        exponent = 1u - shift; // modulo 2^32
    }
    return vec2u(rest << 29u, sign | ((exponent + 896u) << 20u) | (rest >> 3u));
}

// A double as a float; the largest one if it is beyond.
fn narrowed(a: vec2u) -> f32 {
    let sign = a.y & SIGN;
    let exponent = exponent_bits(a) - 896;
    if exponent >= 255 {
        return bitcast<f32>(sign | 0x7f7fffffu);
    }
    let kept = ((a.y & 0xfffffu) << 3u) | (a.x >> 29u);
    let rest = a.x & 0x1fffffffu;
    if exponent >= 1 {
        let is_up = rest > 0x10000000u || (rest == 0x10000000u && (kept & 1u) == 1u);
        let whole = ((u32(exponent) << 23u) | kept) + u32(is_up);
        return bitcast<f32>(sign | min(whole, 0x7f7fffffu));
    }
    // A denormal float: seven bits more than it has, to round.
    if exponent < -24 || exponent_bits(a) == 0 {
        return bitcast<f32>(sign);
    }
    let bits = ((0x800000u | kept) << 7u) | (rest >> 22u) | u32((rest & 0x3fffffu) != 0u);
    let shift = u32(1 - exponent);
    let few = (bits >> shift) | u32((bits << (32u - shift)) != 0u);
    let is_up = (few & 0x7fu) > 0x40u || (few & 0xffu) == 0xc0u;
    return bitcast<f32>(sign | ((few >> 7u) + u32(is_up)));
}
