package nmes_test

import (
	"bufio"
	"bytes"
	"context"
	"crypto/ecdsa"
	"crypto/elliptic"
	"crypto/rand"
	"crypto/tls"
	"crypto/x509"
	"crypto/x509/pkix"
	"encoding/pem"
	"errors"
	"fmt"
	"math/big"
	"net"
	"os"
	"path/filepath"
	"strings"
	"testing"
	"time"

	"nmes"
	"nmes/internal/served"
)

const delimiter = "<???DONE???---"

const welcome = `{"type":"auth_success","protocol":1,"client":1,"world":"main","backend":"b","dims":3,"timestep":1,"tick_rate":1,"mode":"lockstep"}`

// pretend plays a server that answers a connection's frames by script: frame i gets the bytes of answers[i]. What is
// sent goes out in pieces of so many bytes.
func pretend(t *testing.T, piece int, answers ...string) string {
	t.Helper()
	listener, err := net.Listen("tcp", "127.0.0.1:0")
	if err != nil {
		t.Fatal(err)
	}
	t.Cleanup(func() { listener.Close() })
	go func() {
		socket, err := listener.Accept()
		if err != nil {
			return
		}
		defer socket.Close()
		frames := framesOf(socket)
		for _, answer := range answers {
			if !frames.Scan() {
				return
			}
			for data := []byte(answer); len(data) > 0; data = data[min(piece, len(data)):] {
				if _, err := socket.Write(data[:min(piece, len(data))]); err != nil {
					return
				}
			}
		}
	}()
	return listener.Addr().String()
}

func framesOf(socket net.Conn) *bufio.Scanner {
	frames := bufio.NewScanner(socket)
	frames.Split(func(data []byte, end bool) (int, []byte, error) {
		if at := bytes.Index(data, []byte(delimiter)); at >= 0 {
			return at + len(delimiter), data[:at], nil
		}
		return 0, nil, nil
	})
	return frames
}

func TestAClientThatIsClosedWhileItReconnectsIsClosed(t *testing.T) {
	listener, err := net.Listen("tcp", "127.0.0.1:0")
	if err != nil {
		t.Fatal(err)
	}
	defer listener.Close()
	var client *nmes.Client
	entered := make(chan error, 1)
	// Lets somebody in who enters, and calls what happens before he is told.
	greet := func(enter func() error, before func()) *bufio.Scanner {
		go func() { entered <- enter() }()
		socket, err := listener.Accept()
		if err != nil {
			t.Fatal(err)
		}
		t.Cleanup(func() { socket.Close() })
		frames := framesOf(socket)
		if !frames.Scan() {
			t.Fatal(frames.Err())
		}
		before()
		if _, err := socket.Write([]byte(welcome + delimiter)); err != nil {
			t.Fatal(err)
		}
		return frames
	}
	reconnect := func() error { return client.Reconnect(within(t)) }
	greet(func() (err error) {
		client, err = nmes.Dial(within(t), listener.Addr().String(), nmes.Options{Password: password})
		return err
	}, func() {})
	if err := <-entered; err != nil {
		t.Fatal(err)
	}
	frames := greet(reconnect, func() { client.Close() })
	if err := <-entered; !nmes.IsCode(err, "closed") || !nmes.IsCode(client.Err(), "closed") {
		t.Fatal(err, client.Err())
	}
	if frames.Scan() { // until the client hangs up
		t.Fatal(frames.Text())
	}
	greet(reconnect, func() {})
	if err := <-entered; err != nil || client.Err() != nil {
		t.Fatal(err, client.Err())
	}
	client.Close()
}

func TestFramesMayComeInAnyPiecesAndEventsBetweenReplies(t *testing.T) {
	tick := `{"type":"tick","frame":7,"t":0.1}` + delimiter
	novel := `{"type":"novel","x":[1]}` + delimiter
	first := tick + " \n" + delimiter + `{"type":"pong","frame":7,"id":0}` + delimiter + novel
	second := `{"id":1,"frame":8,"type":"pong","ignored":["colour"]}` + delimiter
	for _, piece := range []int{1, 2, 13, 14, 15, 1 << 20} {
		ctx := within(t)
		client, err := nmes.Dial(ctx, pretend(t, piece, welcome+delimiter, first, second), nmes.Options{Password: password})
		if err != nil {
			t.Fatal(err)
		}
		if pong, err := client.Ping(ctx); err != nil || pong.Ignored != nil {
			t.Fatal(piece, pong, err)
		}
		if pong, err := client.Ping(ctx); err != nil || len(pong.Ignored) != 1 {
			t.Fatal(piece, pong, err)
		}
		if event, ok := (<-client.Events()).(*nmes.TickEvent); !ok || event.Frame != 7 {
			t.Fatal(piece, event)
		}
		if event, ok := (<-client.Events()).(*nmes.UnknownEvent); !ok || event.Type != "novel" {
			t.Fatal(piece, event)
		}
		client.Close()
	}
}

func TestAServerThatBreaksTheProtocolEndsTheConnectionAndSaysWhy(t *testing.T) {
	for answer, code := range map[string]string{
		`{"type":"pong","id":1}`: "bad_reply", // not the next in line
		`{"type":"pong","id":0`:  "bad_reply", // no JSON
		`[]`:                     "bad_reply",
		`{"type":"error","code":"slow_consumer","message":"slow"}`: "slow_consumer",
		`{"type":"world_closed"}`:                                  "world_closed",
		``:                                                         "disconnected",
	} {
		ctx := within(t)
		client, err := nmes.Dial(ctx, pretend(t, 99, welcome+delimiter, answer+delimiter), nmes.Options{Password: password})
		if err != nil {
			t.Fatal(err)
		}
		if _, err := client.Ping(ctx); !nmes.IsCode(err, code) {
			t.Fatal(answer, err)
		}
		if _, err := client.Ping(ctx); !nmes.IsCode(err, code) || !nmes.IsCode(client.Err(), code) {
			t.Fatal("it is not lost for good: ", answer, err)
		}
		client.Close()
	}
}

// Answers have no ids in the raw dialect: a late one would be taken for that of the next command.
func TestAContextThatEndsBeforeAnAnswerEndsAnOriginalConnectionAndSaysWhy(t *testing.T) {
	late := `{"type":"late"}` + delimiter + `{"type":"own"}` + delimiter
	old, err := nmes.DialOriginal(within(t), pretend(t, 99, "auth_success"+delimiter, "", late), password, nil)
	if err != nil {
		t.Fatal(err)
	}
	defer old.Close()
	ended, cancel := context.WithCancel(within(t))
	if _, err := old.Ask(ended, cancelling{cancel}); !errors.Is(err, context.Canceled) {
		t.Fatal(err)
	}
	for range 2 {
		if answer, err := old.Ask(within(t), nmes.Ping{}); !nmes.IsCode(err, "closed") || !strings.Contains(err.Error(), "context") {
			t.Fatal(string(answer), err)
		}
	}
	if err := old.Tell(nmes.Ping{}); !nmes.IsCode(err, "closed") {
		t.Fatal(err)
	}
}

// cancelling ends a context while it is encoded.
type cancelling struct{ cancel func() }

func (c cancelling) MarshalJSON() ([]byte, error) {
	c.cancel()
	return []byte(`{"type":"ping"}`), nil
}

func TestAContextThatEndsAroundAnAnswerLeavesAnOriginalConnectionGood(t *testing.T) {
	two := `{"n":1}` + delimiter + `{"n":2}` + delimiter
	old, err := nmes.DialOriginal(within(t), pretend(t, 99, "auth_success"+delimiter, two, "", `{"n":3}`+delimiter), password, nil)
	if err != nil {
		t.Fatal(err)
	}
	defer old.Close()
	ended, cancel := context.WithCancel(within(t))
	if answer, err := old.Ask(ended, nmes.Ping{}); err != nil || string(answer) != `{"n":1}` {
		t.Fatal(string(answer), err)
	}
	if answer, err := old.Ask(ended, cancelling{cancel}); err != nil || string(answer) != `{"n":2}` { // which is there already
		t.Fatal(string(answer), err)
	}
	if answer, err := old.Ask(ended, nmes.Ping{}); !errors.Is(err, context.Canceled) { // and nothing is sent
		t.Fatal(string(answer), err)
	}
	if answer, err := old.Ask(within(t), nmes.Ping{}); err != nil || string(answer) != `{"n":3}` {
		t.Fatal(string(answer), err)
	}
}

func TestItSpeaksTLSWithWhomItTrusts(t *testing.T) {
	key, err := ecdsa.GenerateKey(elliptic.P256(), rand.Reader)
	if err != nil {
		t.Fatal(err)
	}
	template := x509.Certificate{
		SerialNumber: big.NewInt(1), Subject: pkix.Name{CommonName: "nmes"}, IPAddresses: []net.IP{net.IPv4(127, 0, 0, 1)},
		NotBefore: time.Now().Add(-time.Hour), NotAfter: time.Now().Add(time.Hour), IsCA: true, BasicConstraintsValid: true,
	}
	made, err := x509.CreateCertificate(rand.Reader, &template, &template, &key.PublicKey, key)
	if err != nil {
		t.Fatal(err)
	}
	secret, err := x509.MarshalPKCS8PrivateKey(key)
	if err != nil {
		t.Fatal(err)
	}
	folder, trusted := t.TempDir(), x509.NewCertPool()
	certificate := pem.EncodeToMemory(&pem.Block{Type: "CERTIFICATE", Bytes: made})
	trusted.AppendCertsFromPEM(certificate)
	for name, data := range map[string][]byte{
		"cert.pem": certificate, "key.pem": pem.EncodeToMemory(&pem.Block{Type: "PRIVATE KEY", Bytes: secret}),
	} {
		if err := os.WriteFile(filepath.Join(folder, name), data, 0o600); err != nil {
			t.Fatal(err)
		}
	}
	host := served.Start(t, "--tls-cert", filepath.Join(folder, "cert.pem"), "--tls-key", filepath.Join(folder, "key.pem"))
	t.Cleanup(host.Stop)
	ctx, address := within(t), fmt.Sprintf("127.0.0.1:%d", host.Ports[0])
	client, err := nmes.Dial(ctx, address, nmes.Options{Password: password, TLS: &tls.Config{RootCAs: trusted}})
	if err != nil {
		t.Fatal(err)
	}
	defer client.Close()
	if _, err := client.Ping(ctx); err != nil {
		t.Fatal(err)
	}
	stranger := nmes.Options{Password: password, TLS: &tls.Config{RootCAs: x509.NewCertPool()}}
	if _, err := nmes.Dial(ctx, address, stranger); !nmes.IsCode(err, "unreachable") {
		t.Fatal(err)
	}
}
