// Small programs as their authors wrote them for the original server: a TCP socket, the bare password, a delimiter.
//
//	NMES_PASSWORD=... deployed [-port 14000] [-lockstep] PROGRAM
//
// Each says what it does above its function. It ends with a line of JSON, the figures that it found, and status 0; or,
// when the server did not do what the program is for, with `{"failed": why}` and status 1. With -lockstep a program
// waits by telling the world to step, so that nothing depends on how busy the machine is.
package main

import (
	"encoding/json"
	"flag"
	"fmt"
	"os"
)

// Message is a JSON object, whichever way it goes.
type Message map[string]any

var programs = map[string]func() Message{
	"blind_builder":   blindBuilder,
	"waiting_builder": waitingBuilder,
	"caller":          caller,
	"mute_motors":     muteMotors,
	"repeater":        repeater,
	"joint_maker":     jointMaker,
	"scanner":         scanner,
	"planet_reader":   planetReader,
	"controller":      controller,
	"trajectory":      trajectory,
	"pole":            pole,
	"slider_snake":    sliderSnake,
	"bones":           bones,
	"chain":           chain,
	"body":            body,
	"heap":            heap,
}

var (
	port     = flag.Int("port", 14000, "port of the server, on this machine")
	lockstep = flag.Bool("lockstep", false, "wait by steps of the world instead of by the clock")
	count    = flag.Int("count", 40, "heap: how many cubes; scanner: how many ports")
	run      = flag.String("run", "", "trajectory: the saved run, a CSV file")
)

func main() {
	flag.Parse()
	program, known := programs[flag.Arg(0)]
	if !known || flag.NArg() != 1 {
		fmt.Fprintln(os.Stderr, "deployed: name one program")
		os.Exit(2)
	}
	defer func() {
		switch why := recover().(type) {
		case nil:
		case failure:
			report(Message{"failed": string(why)})
			os.Exit(1)
		default:
			panic(why)
		}
	}()
	report(program())
}

func report(figures Message) {
	line, err := json.Marshal(figures)
	if err != nil {
		panic(err)
	}
	fmt.Println(string(line))
}

// failure is why a program gives up.
type failure string

// expect gives up unless something holds.
func expect(holds bool, format string, arguments ...any) {
	if !holds {
		panic(failure(fmt.Sprintf(format, arguments...)))
	}
}

// must gives up on an error.
func must(err error) {
	expect(err == nil, "%v", err)
}
