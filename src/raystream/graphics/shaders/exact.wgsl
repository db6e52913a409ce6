// Exact and nearly exact arithmetic, with rounding errors as numbers of their own.
//
// A triangle test is watertight if triangles that share an edge round alike. Shader compilers may
// fuse a product with a sum, and cancel terms, but not through rounded(), because they do not know
// that params.zero is 0. WGSL has no 64-bit floats; in their place, a Wide is the sum of two
// float32, of about 46 bits.
//
// Sources: Dekker, "A Floating-Point Technique for Extending the Available Precision", Numerische
// Mathematik 18, 1971; Knuth, "The Art of Computer Programming", volume 2, section 4.2.2.

// high + low, where low is at most half a unit in the last place of high.
struct Wide {
    high: f32,
    low: f32,
}

// x, rounded to float32: not fused with anything, nor cancelled.
fn rounded(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ params.zero);
}

// The first 12 bits of x: the product of two such numbers is exact.
fn leading(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) & 0xfffff000u);
}

// The rounding error of product = rounded(a * b). Each term is exact, in this order.
fn product_error(a: f32, b: f32, product: f32) -> f32 {
    let a_high = leading(a);
    let b_high = leading(b);
    let a_low = rounded(a - a_high);
    let b_low = rounded(b - b_high);
    let rest = rounded(rounded(rounded(a_high * b_high) - product) + rounded(a_high * b_low));
    return rounded(rounded(rest + rounded(a_low * b_high)) + rounded(a_low * b_low));
}

fn exact_product(a: f32, b: f32) -> Wide {
    let product = rounded(a * b);
    return Wide(product, product_error(a, b, product));
}

fn exact_sum(a: f32, b: f32) -> Wide {
    let sum = rounded(a + b);
    let b_part = rounded(sum - a);
    let a_part = rounded(sum - b_part);
    return Wide(sum, rounded(rounded(a - a_part) + rounded(b - b_part)));
}

// The same for |a| >= |b|, or a = 0 = b.
fn ordered_sum(a: f32, b: f32) -> Wide {
    let sum = rounded(a + b);
    return Wide(sum, rounded(b - rounded(sum - a)));
}

fn wide_sum(a: Wide, b: Wide) -> Wide {
    let high = exact_sum(a.high, b.high);
    let low = exact_sum(a.low, b.low);
    let most = ordered_sum(high.high, rounded(high.low + low.high));
    return ordered_sum(most.high, rounded(most.low + low.low));
}

fn wide_difference(a: Wide, b: Wide) -> Wide {
    return wide_sum(a, Wide(-b.high, -b.low));
}

fn wide_product(a: Wide, b: Wide) -> Wide {
    let high = exact_product(a.high, b.high);
    let cross = rounded(rounded(a.high * b.low) + rounded(a.low * b.high));
    return ordered_sum(high.high, rounded(high.low + cross));
}

// Whether the device's fma() rounds once: WGSL allows a product and a sum.
override FUSED: bool = false;

// a * b + c, rounded once, so that it is monotone in each and equals the CPU's. (Emulated, one
// result in some millions is rounded the other way.)
fn fused(a: f32, b: f32, c: f32) -> f32 {
    if FUSED {
        return fma(a, b, c);
    }
    let product = exact_product(a, b);
    let sum = exact_sum(product.high, c);
    return rounded(sum.high + rounded(sum.low + product.low));
}

fn fused3(a: vec3f, b: vec3f, c: vec3f) -> vec3f {
    return vec3f(fused(a.x, b.x, c.x), fused(a.y, b.y, c.y), fused(a.z, b.z, c.z));
}

// a / b, correctly rounded except near ties: a device's own division may be off by 2.5 units in the
// last place. b is not 0.
fn quotient(a: f32, b: f32) -> f32 {
    let first = rounded(a / b);
    let product = rounded(first * b);
    let rest = rounded(rounded(a - product) - product_error(first, b, product));
    return rounded(first + rounded(rest / b));
}

// Two steps of long division. b is not 0.
fn wide_quotient(a: Wide, b: Wide) -> f32 {
    let first = rounded(a.high / b.high);
    let rest = wide_difference(a, wide_product(b, Wide(first, 0.0)));
    let second = rounded(rest.high / b.high);
    let last = wide_difference(rest, wide_product(b, Wide(second, 0.0)));
    let third = rounded(last.high / b.high);
    let tail = exact_sum(second, third);
    let sum = exact_sum(first, tail.high);
    return rounded(sum.high + rounded(sum.low + tail.low));
}

fn times(a: f32, b: Wide) -> Wide {
    return wide_product(Wide(a, 0.0), b);
}

// a * b - c * d, exact but for the last sum.
fn wide_determinant(a: f32, b: f32, c: f32, d: f32) -> Wide {
    let left = exact_product(a, b);
    let right = exact_product(c, d);
    return wide_difference(left, right);
}

fn wide_cross(a: Wide, b: Wide, c: Wide, d: Wide) -> Wide {
    return wide_difference(wide_product(a, b), wide_product(c, d));
}
