// Shows which kernel the ray of each pixel waits for, by the color of its state; pixels that are
// finished show their light.

//! include "multipass/states.wgsl"
//! include "page/show.wgsl"

@group(0) @binding(2) var states: texture_2d<u32>;
@group(0) @binding(3) var light: texture_2d<f32>;
// Of each state, encoded as sRGB.
@group(0) @binding(4) var<uniform> colors: array<vec4f, 16>;

@fragment
fn show_states(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let place = min(vec2u(position.xy), vec2u(picture.width - 1u, picture.height - 1u));
    let pixel = place.y * picture.width + place.x;
    let row_size = textureDimensions(states).x;
    let texel = vec2u(pixel % row_size, pixel / row_size);
    let state = textureLoad(states, texel, 0).x;
    if state == DONE {
        let found = textureLoad(light, texel, 0).rgb;
        return vec4f(encoded(clamp(found, vec3f(0.0), vec3f(1.0))), 1.0);
    }
    return colors[state];
}
