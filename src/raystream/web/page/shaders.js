// Assembles WGSL files that include each other: as raystream/graphics/shader_source.py and
// gather_arrays.py, from the same files.

const INCLUDE = /^\/\/! include "([a-z0-9_/]+\.wgsl)"$/gm;
const TREE_GROUP = 1;
const WIDTH_BITS = 12;
export const TEXTURE_WIDTH = 1 << WIDTH_BITS;

/** Texels of arrays in textures, by the type of an element. */
export const TEXELS = {
  f32: {format: "r32float", words: 1, sampleType: "unfilterable-float", sampled: "f32", part: ".x"},
  u32: {format: "r32uint", words: 1, sampleType: "uint", sampled: "u32", part: ".x"},
  i32: {format: "r32sint", words: 1, sampleType: "sint", sampled: "i32", part: ".x"},
  vec2u: {format: "rg32uint", words: 2, sampleType: "uint", sampled: "u32", part: ".xy"},
  vec4u: {format: "rgba32uint", words: 4, sampleType: "uint", sampled: "u32", part: ""},
};

const DECLARED =
  /^@group\((\d)\) @binding\((\d)\) var<storage, read> (\w+): array<(\w+)>;$/gm;

/** Include each of some files once; `instead` has files that replace others. */
export function shaderSource(files, names, {instead = {}, treeGroup = TREE_GROUP, sizes = {}} = {}) {
  const seen = new Set();
  const included = asked => {
    const name = instead[asked] ?? asked;
    if (seen.has(name)) return "";
    seen.add(name);
    let text = files[name];
    if (!name.startsWith("rendering/")) {
      text = text.replaceAll(`@group(${TREE_GROUP})`, `@group(${treeGroup})`);
    }
    return `// ${name}\n${text.replace(INCLUDE, (_, inner) => included(inner))}`;
  };
  const declared = Object.entries(sizes).map(([name, size]) => `const ${name}: u32 = ${size}u;`);
  return [...declared, ...names.map(included)].join("\n");
}

/** The gather arrays that a source declares in a group: binding and type of an element. */
export function gatherArrays(source, group) {
  return [...source.matchAll(DECLARED)]
    .filter(([, number]) => Number(number) === group)
    .map(([, , binding, name, element]) => ({binding: Number(binding), name, element}));
}

/** A source whose gather arrays of one group are textures. */
export function inTextures(source, group) {
  const names = gatherArrays(source, group).map(({name}) => name);
  source = source.replace(DECLARED, (whole, number, binding, name, element) => {
    if (Number(number) !== group) return whole;
    const texel = TEXELS[element];
    return [
      `@group(${number}) @binding(${binding}) var ${name}_texels: texture_2d<${texel.sampled}>;`,
      `fn ${name}_at(index: u32) -> ${element} {`,
      `    let place = vec2u(index & ${TEXTURE_WIDTH - 1}u, index >> ${WIDTH_BITS}u);`,
      `    return textureLoad(${name}_texels, place, 0)${texel.part};`,
      "}",
    ].join("\n");
  });
  return names.length ? withCalls(source, names) : source;
}

/** Replace name[index] by name_at(u32(index)), also within an index. */
function withCalls(source, names) {
  const read = new RegExp(`\\b(${names.join("|")})\\[`);
  let done = "";
  for (let match = read.exec(source); match; match = read.exec(source)) {
    let [depth, end] = [1, match.index + match[0].length];
    const start = end;
    while (depth) {
      depth += {"[": 1, "]": -1}[source[end]] ?? 0;
      end += 1;
    }
    const index = withCalls(source.slice(start, end - 1), names);
    done += `${source.slice(0, match.index)}${match[1]}_at(u32(${index}))`;
    source = source.slice(end);
  }
  return done + source;
}
