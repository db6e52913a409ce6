// Whether this browser has WebGPU.

/** Why a page has no WebGPU; null if it has. */
export function missingWebGpu() {
  if (navigator.gpu) return null;
  return isSecureContext ? "This browser has no WebGPU."
    : "Browsers offer WebGPU only to pages from disk, from this computer or over HTTPS.";
}
