// A minimal server of the NMES protocol, version 1: one world of free bodies, the commands that every server must have,
// and those that make it testable. It is written from the protocol's page and its JSON Schemas alone and needs nothing
// but the standard library.
//
//	NMES_PASSWORD=... go run . -addr 127.0.0.1:14000 -mode lockstep
//
// Boxes fly, rest on the ground and are held by joints, but do not touch each other.
package main

import (
	"flag"
	"fmt"
	"log"
	"net"
	"os"
)

func main() {
	log.SetFlags(0)
	address := flag.String("addr", "127.0.0.1:14000", "where to listen; with port 0, on any free port")
	password := flag.String("password", os.Getenv("NMES_PASSWORD"), "or NMES_PASSWORD")
	mode := flag.String("mode", "realtime", "realtime, lockstep or fast")
	seed := flag.Int64("seed", 0, "what names are drawn from, from 0")
	host := &Host{world: &World{name: "main"}}
	flag.IntVar(&host.world.mostCubes, "cubes", 10000, "cubes at most")
	flag.IntVar(&host.world.mostJoints, "joints", 20000, "joints at most")
	limits := &host.limits
	flag.IntVar(&limits.frame, "frame", 1<<20, "bytes of a frame at most")
	flag.IntVar(&limits.authFrame, "auth-frame", 16<<10, "bytes of the first frame at most")
	flag.IntVar(&limits.pending, "pending", 8<<20, "bytes that a peer may leave unread")
	flag.IntVar(&limits.connections, "connections", 1024, "connections at most")
	flag.DurationVar(&limits.auth, "auth-timeout", fiveSeconds, "time for the first frame")
	flag.DurationVar(&limits.idle, "idle-timeout", fiveMinutes, "time without a frame until a connection is closed")
	flag.DurationVar(&limits.stall, "stall-timeout", 2*fiveSeconds, "time for which a peer may read nothing")
	flag.Parse()
	if *password == "" {
		log.Fatal("a password is needed: -password, or NMES_PASSWORD")
	}
	if wrong := oneOf("realtime", "lockstep", "fast")(*mode, "mode"); wrong != nil || *seed < 0 {
		log.Fatal("mode is realtime, lockstep or fast, and seed at least 0")
	}
	host.password, host.world.mode = *password, *mode
	host.world.reset(*seed)
	listener, err := net.Listen("tcp", *address)
	if err != nil {
		log.Fatal(err)
	}
	fmt.Println("Listening on", listener.Addr())
	go host.keepTime()
	log.Fatal(host.serve(listener))
}
