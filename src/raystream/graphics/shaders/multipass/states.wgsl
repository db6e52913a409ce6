// States of rays: values of the stencil. As raystream/machines/records.py.
const DONE: u32 = 0u;
const STARTING: u32 = 1u;
const TRAVERSING: u32 = 2u;
const INTERSECTING: u32 = 3u;
const SHADING: u32 = 4u;
const AT_LEAF: u32 = 5u;
const CONTINUING: u32 = 6u;
const BACKTRACKING: u32 = 7u;
const NO_ROOM: u32 = 8u;
