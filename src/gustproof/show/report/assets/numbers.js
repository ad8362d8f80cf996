"use strict";
// Numbers of the page: float32 in four planes of bytes, zlib, base64 (see html/page.py). Arrays are [offset, length].
const numbers = {
  values: new Float32Array(0),
  async unpack(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const count = planes.length / 4, bytes = new Uint8Array(planes.length);
    for (let i = 0; i < count; i++) for (let k = 0; k < 4; k++) bytes[4 * i + k] = planes[k * count + i];
    this.values = new Float32Array(bytes.buffer);
  },
  at([start, length]) { return this.values.subarray(start, start + length); },
};
