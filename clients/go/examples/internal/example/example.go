// Package example is the common part of the examples: the connection to the server, and the report of what was measured.
package example

import (
	"context"
	"encoding/json"
	"flag"
	"fmt"
	"math"
	"os"
	"os/signal"

	"nmes"
)

// Figure is one measured number, and the range that it should be in.
type Figure struct {
	Name            string
	Value           float64
	Unit            string
	AtLeast, AtMost float64
}

// Known returns a figure without an aim.
func Known(name string, value float64, unit string) Figure {
	return Figure{name, value, unit, math.Inf(-1), math.Inf(1)}
}

func (f Figure) ok() bool { return f.AtLeast <= f.Value && f.Value <= f.AtMost }

// Connect enters the world once more.
type Connect func() (*nmes.Client, error)

// Main runs an example from the command line: connects, measures, prints, and ends with status 1 if an aim was missed.
func Main(measure func(ctx context.Context, connect Connect) ([]Figure, error)) {
	address := flag.String("addr", "127.0.0.1:14000", "where the world is served; its password is in "+nmes.PasswordVariable)
	asJSON := flag.Bool("json", false, "print the figures as JSON")
	flag.Parse()
	ctx, stop := signal.NotifyContext(context.Background(), os.Interrupt)
	figures, err := measure(ctx, func() (*nmes.Client, error) { return nmes.Dial(ctx, *address, nmes.Options{}) })
	stop()
	if err != nil {
		fmt.Fprintln(os.Stderr, err)
		os.Exit(1)
	}
	values, status := map[string]float64{}, 0
	for _, figure := range figures {
		values[figure.Name] = figure.Value
		verdict := ""
		if !figure.ok() {
			verdict, status = "MISSED", 1
		}
		if !*asJSON {
			fmt.Printf("%-28s %9.3f %-4s %s\n", figure.Name, figure.Value, figure.Unit, verdict)
		}
	}
	if *asJSON {
		if err := json.NewEncoder(os.Stdout).Encode(values); err != nil {
			fmt.Fprintln(os.Stderr, err)
			status = 1
		}
	}
	os.Exit(status)
}

// Lockstep empties a world and has it wait for each step.
func Lockstep(ctx context.Context, client *nmes.Client) error {
	if _, err := client.SetMode(ctx, nmes.SetMode{Mode: "lockstep"}); err != nil {
		return err
	}
	_, err := client.Reset(ctx, nmes.Reset{})
	return err
}
