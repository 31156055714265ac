def publish(preset, store, console):
    console.print("done")
