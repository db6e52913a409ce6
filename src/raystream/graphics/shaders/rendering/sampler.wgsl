// Random numbers of a pixel's samples, with the bits of the CPU's. As
// raystream/rendering/sampling/hashing.py, owen.py and random.py, where the reasons are.

//! include "rendering/shading.wgsl"

// Index into rendering.sampling.sampler.KINDS; "stratified" is not supported.
const SOBOL: u32 = 0u;

fn mix_bits(x: u32) -> u32 {
    var y = (x ^ (x >> 16u)) * 0x21f0aaadu;
    y = (y ^ (y >> 15u)) * 0xd35a2d97u;
    return y ^ (y >> 15u);
}

// The key of a pixel's numbers in a dimension, or a group of them.
fn stream_key(place: u32, dimension: u32) -> u32 {
    let at_pixel = mix_bits(mix_bits(shading.seed + 0x9e3779b9u) ^ place);
    return mix_bits(at_pixel ^ mix_bits(dimension + 0x6a09e667u));
}

// The upper 24 bits as a fraction.
fn as_float(bits: u32) -> f32 {
    return f32(bits >> 8u) * 0x1p-24;
}

// Sobol's second matrix, Pascal's triangle modulo 2, times a vector of bits.
fn pascal(x: u32) -> u32 {
    var y = x ^ (x >> 16u);
    y ^= (y >> 8u) & 0x00ff00ffu;
    y ^= (y >> 4u) & 0x0f0f0f0fu;
    y ^= (y >> 2u) & 0x33333333u;
    return y ^ ((y >> 1u) & 0x55555555u);
}

// The index of a sample in a group's second pair: a matrix times x.
fn second_pair(x: u32) -> u32 {
    var product = 0u;
    for (var bit = 0u; bit < 32u; bit++) {
        let column = shading.quads[bit / 4u][bit % 4u];
        product ^= select(0u, column, ((x >> bit) & 1u) != 0u);
    }
    return product;
}

// Flip each bit by a hash of the bits below it and of a key.
fn scramble(x: u32, key: u32) -> u32 {
    var y = x ^ (x * 0x3d20adeau);
    y = (y + key) * ((key >> 16u) | 1u);
    y ^= y * 0x05526c56u;
    return y ^ (y * 0x53a22864u);
}

// Index of a sample in the (0, 2)-sequence of a group's pair.
fn sequence_index(sample: u32, dimension: u32, key: u32) -> u32 {
    let index = reverseBits(scramble(reverseBits(sample), mix_bits(key ^ 0xb5297a4du)));
    if (dimension & 2u) != 0u {
        return second_pair(index);
    }
    return index;
}

fn random_number(place: u32, sample: u32, dimension: u32) -> f32 {
    return as_float(mix_bits(stream_key(place, dimension) ^ mix_bits(sample + 0xbb67ae85u)));
}

// One number of one sample of a pixel, in [0, 1).
fn draw_number(place: u32, sample: u32, dimension: u32) -> f32 {
    if SAMPLER != SOBOL {
        return random_number(place, sample, dimension);
    }
    let key = stream_key(place, dimension >> 2u);
    var index = sequence_index(sample, dimension, key);
    if (dimension & 1u) != 0u {
        index = pascal(index);
    }
    return as_float(reverseBits(scramble(index, mix_bits(key + (dimension & 3u)))));
}

// The numbers of an even dimension and the next.
fn draw_pair(place: u32, sample: u32, dimension: u32) -> vec2f {
    if SAMPLER != SOBOL {
        let second = random_number(place, sample, dimension + 1u);
        return vec2f(random_number(place, sample, dimension), second);
    }
    let key = stream_key(place, dimension >> 2u);
    let index = sequence_index(sample, dimension, key);
    let in_group = dimension & 2u;
    let x = scramble(index, mix_bits(key + in_group));
    let y = scramble(pascal(index), mix_bits(key + in_group + 1u));
    return vec2f(as_float(reverseBits(x)), as_float(reverseBits(y)));
}
