// A bag as @mcap/core and Foxglove's ROS 2 decoder read it: `node mcap_reader.mjs MODULES FILE` prints, as one JSON
// object, for each topic the log times [ns] and all numbers of all its messages, depth first in the definitions' order.

import { open } from 'node:fs/promises'
import { createRequire } from 'node:module'

const [modules, file] = process.argv.slice(2)
const require = createRequire(modules)
const { McapIndexedReader } = require('@mcap/core')
const { parse } = require('@foxglove/rosmsg')
const { MessageReader } = require('@foxglove/rosmsg2-serialization')
const fzstd = require('fzstd')

function* leaves(value) {
  if (typeof value === 'object') for (const item of Object.values(value)) yield* leaves(item)
  else yield Number.isNaN(value) ? 'NaN' : value // which JSON does not know
}

const handle = await open(file)
const readable = {
  size: async () => BigInt((await handle.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length))
    await handle.read(buffer, 0, Number(length), Number(offset))
    return buffer
  },
}
const reader = await McapIndexedReader.Initialize({
  readable, decompressHandlers: { zstd: (data, size) => fzstd.decompress(data, new Uint8Array(Number(size))) },
})
const decoders = new Map()
const topics = {}
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId)
  if (!decoders.has(channel.id)) {
    const text = new TextDecoder().decode(reader.schemasById.get(channel.schemaId).data)
    decoders.set(channel.id, new MessageReader(parse(text, { ros2: true })))
  }
  const found = (topics[channel.topic] ??= { times: [], values: [] })
  found.times.push(Number(message.logTime))
  found.values.push([...leaves(decoders.get(channel.id).readMessage(message.data))])
}
await handle.close()
console.log(JSON.stringify(topics))
